/* Makes one field of a good configuration wrong at a time: fo_init must refuse it, and fo_wrong
 * must name the field. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fluxobs_config.h"

static int failures = 0;
static const fo_real NANS = (fo_real)NAN;

static void expect(const fo_config *config, fo_error error, const char *field)
{
    fo_observer observer;
    const char *found = fo_wrong(config);
    if (fo_init(&observer, config) != error || found == NULL || strcmp(found, field) != 0) {
        printf("%s: error %d, named %s\n", field, (int)fo_init(&observer, config),
               found == NULL ? "nothing" : found);
        failures++;
    }
}

static void spoil(const fo_config *good, size_t offset, fo_real by, fo_error error, const char *field)
{
    fo_config config = *good;
    memcpy((unsigned char *)&config + offset, &by, sizeof by);
    expect(&config, error, field);
}

#define NOT_A_NUMBER(name) spoil(&good, offsetof(fo_config, name), NANS, FO_ERROR_NOT_FINITE, #name);
#define POSITIVE_NUMBER(name, least, most) \
    NOT_A_NUMBER(name)                     \
    if (strcmp(#name, "sample_time") != 0 && strcmp(#name, "memory") != 0) \
        spoil(&good, offsetof(fo_config, name), (fo_real)-1, FO_ERROR_BASE, #name);

int main(void)
{
    fo_config good;
    fo_adaptive_config adaptive;
    fo_adaptive observer;
    const fo_machine m = fo_pmsm((fo_real)0.36, (fo_real)0.2e-3, (fo_real)12.5e-3, (fo_real)10.3);
    (void)fo_configure(&good, &m, (fo_real)1e-4);
    if (fo_wrong(&good) != NULL) {
        printf("a good configuration has %s wrong\n", fo_wrong(&good));
        failures++;
    }
    FO_CONFIG_FIELDS(NOT_A_NUMBER, NOT_A_NUMBER, NOT_A_NUMBER, POSITIVE_NUMBER)
    spoil(&good, offsetof(fo_config, sample_time), (fo_real)0, FO_ERROR_SAMPLE_TIME, "sample_time");
    spoil(&good, offsetof(fo_config, memory), (fo_real)5e-4, FO_ERROR_SAMPLE_TIME, "memory");
    spoil(&good, offsetof(fo_config, R), (fo_real)36e6, FO_ERROR_RANGE, "R"); /* in microohms */
    spoil(&good, offsetof(fo_config, constraint_noise), (fo_real)1e9, FO_ERROR_RANGE,
          "constraint_noise");
    fo_adaptive_choose(&adaptive, &m, (fo_real)1e-4, (fo_real)48, FO_LEARN_RESISTANCE);
    adaptive.inverter_current = (fo_real)0;
    if (fo_adaptive_init(&observer, &good, &adaptive) != FO_ERROR_BASE ||
        strcmp(fo_adaptive_wrong(&good, &adaptive), "inverter_current") != 0) {
        printf("inverter_current is not named\n");
        failures++;
    }
    good.R[0][0] = NANS;
    if (strcmp(fo_adaptive_wrong(&good, &adaptive), "R") != 0) {
        printf("R is not named by the adaptive observer\n");
        failures++;
    }
    return failures;
}
