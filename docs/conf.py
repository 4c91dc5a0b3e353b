"""How `make docs` builds the site. It needs no network, and neither does the finished site."""

import os
import sys
import tempfile
from importlib.metadata import version as installed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
# Commands and notebooks on the pages find the program and each other, and look alike everywhere.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ |= {"COLUMNS": "88", "NO_COLOR": "1", "TERM": "dumb", "JAX_PLATFORMS": "cpu"}
# Pages are made side by side: threads within each would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Most of the pages' time is compilation.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
os.environ["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"

# Compiled once, used again by the next build.
cache = Path(__file__).parent.parent / "build" / "jax"
os.environ |= {
    "JAX_COMPILATION_CACHE_DIR": str(cache),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
}
# The kernels of the notebooks log nothing at their start.
profile = Path(tempfile.mkdtemp(prefix="fluxobs-docs-")) / "profile_default"
profile.mkdir()
(profile / "ipython_kernel_config.py").write_text("get_config().IPKernelApp.log_level = 40\n")
os.environ["IPYTHONDIR"] = str(profile.parent)

project = "fluxobs"
author = "the fluxobs authors"
copyright = author
version = release = installed("fluxobs")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinxcontrib.bibtex",
    "from_code",
    "cite_dois",
]
exclude_patterns = ["_ext"]
smartquotes = False  # --lag is an option
templates_path: list[str] = []

bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"

myst_heading_anchors = 3
myst_enable_extensions = ["deflist", "colon_fence", "fieldlist"]
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 180
nb_execution_in_temp = True
nb_merge_streams = True

html_theme = "furo"
html_title = "fluxobs"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
copybutton_exclude = ".linenos, .gp"

napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_ivar = True
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True

# Each reference must have a target; base classes of other packages are only named.
nitpicky = True
nitpick_ignore_regex = [("py:class", r"(equinox|pydantic|numpy|jax|typing)\b.*|Generic|Found")]
