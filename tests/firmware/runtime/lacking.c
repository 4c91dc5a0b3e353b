/* For an exported folder whose sources leave out held voltages and matrices that are not multiples
 * of the identity. A configuration that needs these features must be refused, with the name of the
 * field. */
#include <stdio.h>
#include <string.h>

#include "fluxobs_config.h"

static int failures = 0;

static void refused(const fo_config *config, const char *field)
{
    fo_observer observer;
    const char *found = fo_wrong(config);
    if (fo_init(&observer, config) != FO_ERROR_OTHER || !found || strcmp(found, field) != 0) {
        printf("%s is not refused but %s\n", field, found ? found : "nothing");
        failures++;
    }
}

int main(void)
{
    fo_config good, config;
    const fo_machine m = fo_pmsm((fo_real)0.36, (fo_real)0.6e-3, (fo_real)12.5e-3, (fo_real)12);
    (void)fo_configure(&good, &m, (fo_real)1e-4);
    if (FO_HELD || !FO_ISOTROPIC || fo_wrong(&good) != NULL) {
        printf("not the sources that were meant\n");
        failures++;
    }
    config = good;
    config.R[0][1] = (fo_real)0.01;
    refused(&config, "R");
    config = good;
    config.Q2[1][1] *= (fo_real)1.5;
    refused(&config, "Q2");
    config = good;
    config.E[1] = (fo_real)1e-4;
    refused(&config, "E");
    config = good;
    config.kink_now = (fo_real)0.02;
    refused(&config, "R"); /* R is large compared with L over the sample time */
    return failures;
}
