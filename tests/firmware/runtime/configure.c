/* Prints the bits of a machine's configuration: the observer, its map, and the adaptive observer
 * with all unknowns. Arguments: kind, R_s, L_d, L_q, psi, R_R, L_M, rated current, electrical
 * speed, sample time, DC link. */
#include <stdio.h>
#include <stdlib.h>

#include "fluxobs_config.h"

static void say(const char *name, const fo_real *numbers, size_t count)
{
    printf("%s", name);
    for (size_t n = 0; n < count; n++) {
        printf(" %a", (double)numbers[n]);
    }
    printf("\n");
}

#define SAY_MATRIX(name, meaning) say(#name, &observer.plain.name[0][0], FO_N * FO_N);
#define SAY_ARRAY(name, size, meaning) say(#name, observer.plain.name, size);
#define SAY_NUMBER(name, meaning) say(#name, &observer.plain.name, 1);
#define SAY_MORE(name, size, meaning) say(#name, observer.name, size);
#define SAY_ONE(name, meaning) say(#name, &observer.name, 1);
#define SAY_MAP(name) say("map_" #name, &map.name, 1);

int main(int count, char **given)
{
    fo_real x[10];
    fo_config config;
    fo_adaptive_config adaptive;
    fo_adaptive observer;
    fo_map map;
    if (count != 12) {
        return 2;
    }
    for (int n = 0; n < 10; n++) {
        x[n] = (fo_real)strtod(given[2 + n], NULL);
    }
    const int kind = atoi(given[1]);
    fo_machine m = kind == 0   ? fo_pmsm(x[0], x[2], x[3], x[6])
                   : kind == 1 ? fo_ipmsm(x[0], x[1], x[2], x[3], x[6])
                   : kind == 2 ? fo_synrm(x[0], x[1], x[2], x[6])
                               : fo_induction(x[0], x[4], x[2], x[5], x[3], x[6]);
    m.speed_e = x[7];
    const char *wrong = fo_configure(&config, &m, x[8]);
    if (wrong != NULL) {
        printf("refused: %s\n", wrong);
        return 1;
    }
    fo_adaptive_choose(&adaptive, &m, x[8], x[9],
                       FO_LEARN_RESISTANCE | FO_LEARN_INVERTER | FO_LEARN_ASYMMETRY);
    if (fo_adaptive_init(&observer, &config, &adaptive) != FO_OK) {
        printf("refused: %s\n", fo_adaptive_wrong(&config, &adaptive));
        return 1;
    }
    FO_OBSERVER_FIELDS(SAY_MATRIX, SAY_ARRAY, SAY_NUMBER)
    FO_ADAPTIVE_FIELDS(SAY_MORE, SAY_ONE)
    if (fo_map_of(&map, &m, x[8])) {
        FO_MAP_FIELDS(SAY_MAP)
    }
    return 0;
}
