from hypothesis import settings

# Deterministic, and no deadline: a slow machine is no failure.
settings.register_profile("fluxobs", deadline=None, derandomize=True)
settings.load_profile("fluxobs")
