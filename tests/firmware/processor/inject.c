/* Instructions of the injector: while it searches, and while the observer runs. */
#include "fluxobs_inject.h"
#include "target.h"

static fo_injector injector;
static fo_injector_state state;
static fo_adaptive_estimate estimate;

/* Returns the most ticks of a call, among 200. */
static uint32_t most_ticks(void)
{
    uint32_t most = 0U;
    for (int k = 0; k < 200; k++) {
        const float sign = k % 2 == 0 ? 1.0f : -1.0f;
        const fo_real voltage[FO_N] = {100.0f * sign, 20.0f * sign};
        const fo_real current[FO_N] = {0.1f * sign, 0.05f};
        fo_injection injection;
        const uint32_t before = target_ticks();
        fo_inject(&injector, &state, &estimate, voltage, current, &injection);
        const uint32_t ticks = (before - target_ticks()) & 0xFFFFFFU;
        most = ticks > most ? ticks : most;
    }
    return most;
}

int main(void)
{
    const fo_injector_config config = {1e-4f, 36e-3f, 54e-3f, 0.545f, 0.35f, 250.0f, 2.0f,
                                       0.014f, 0.03f, 47.0f};
    target_start_ticks();
    const uint32_t first = target_ticks(), second = target_ticks();
    const bool usable = fo_injector_init(&injector, &config);
    const uint32_t searching = most_ticks();
    state.phase = FO_INJECT_RUN;
    estimate.adapting = true;
    estimate.position.theta_e = 0.5f;
    const uint32_t running = most_ticks();
    target_number("reading", (int32_t)((first - second) & 0xFFFFFFU));
    target_number("searching", (int32_t)searching);
    target_number("running", (int32_t)running);
    target_number("parameters", (int32_t)sizeof injector);
    return usable ? 0 : 1;
}
