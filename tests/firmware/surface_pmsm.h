/* Matrices of a surface PMSM, for tests that configure an observer by hand. */
#ifndef SURFACE_PMSM_H
#define SURFACE_PMSM_H

#include <string.h>

#include "fluxobs.h"

static void surface_pmsm(fo_config *c, double R, double L)
{
    memset(c, 0, sizeof *c);
    for (int i = 0; i < FO_N; i++) {
        c->Q1[i][i] = (fo_real)1;
        c->Q2[i][i] = (fo_real)(-2 * L);
        c->Q3[i][i] = (fo_real)(L * L);
        c->R[i][i] = (fo_real)R;
        c->B[i][i] = (fo_real)1;
    }
    c->L_position = (fo_real)L;
}

#endif
