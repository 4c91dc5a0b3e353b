/* Instructions for a motor chosen in the field before its first step: configuration and fo_init. */
#include "fluxobs_config.h"
#include "target.h"

static fo_observer observer;

static __attribute__((noinline)) fo_error configured(void)
{
    fo_config config;
    const fo_machine machine = fo_pmsm(0.36f, 0.6e-3f, 12.5e-3f, 12.0f);
    (void)fo_configure(&config, &machine, 1e-4f);
    return fo_init(&observer, &config);
}

int main(void)
{
    target_start_ticks();
    const uint32_t first = target_ticks(), second = target_ticks();
    const fo_error error = configured();
    const uint32_t third = target_ticks();
    target_number("reading", (int32_t)((first - second) & 0xFFFFFFU));
    target_number("configuring", (int32_t)((second - third) & 0xFFFFFFU));
    target_number("parameters", (int32_t)sizeof observer);
    return (int)error;
}
