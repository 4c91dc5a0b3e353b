/* fluxobs, flux maps: for machines that saturate, or whose i_d or rotor flux changes.
 *
 * A machine has the flux e^{j phi} F(e^{-j phi} i), where F is its flux over the current in rotor
 * coordinates. Two vectors follow from F and its derivative J at the angle where the rotor is
 * expected (docs/theory.md, section 14):
 *
 *   the auxiliary flux     a = F + j J(j i): an error e of the angle moves F by -e j a,
 *   the position vector    flux - e^{j phi} (F - a_d), along d: its angle is exact to first order.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_MAP_H
#define FLUXOBS_MAP_H

#include "fluxobs_real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Kinds of flux maps, by the definition of F. */
typedef enum {
    FO_MAP_LINEAR, /* psi + L_d i_d + j L_q i_q                                             */
    FO_MAP_TABLE,  /* quadratic B-splines over a grid of currents                           */
    FO_MAP_CAGE    /* psi + L i, where d is along the rotor flux psi, which follows i_d     */
} fo_map_kind;

/* Flux map of one machine. Fields of other kinds are 0. */
#define FO_MAP_FIELDS(NUMBER)                                                                   \
    NUMBER(psi)      /* magnet flux [Wb]; 0 for a cage                                       */ \
    NUMBER(L_d)      /* linear map: L_d; cage: leakage inductance [H]                        */ \
    NUMBER(L_q)                                                                                 \
    NUMBER(decay)    /* cage: share of its flux that decays in a sample, R_R h / L_M         */ \
    NUMBER(still)    /* cage: its flux is constant below this change of i_d [A]               */ \
    NUMBER(ripple)   /* cage: rate at which a current offset turns its flux [rad/s]          */ \
    NUMBER(least_d)  /* table: lowest i_d [A]                                                */ \
    NUMBER(most_d)   /* table: highest i_d [A]                                               */ \
    NUMBER(over_d)   /* table: 1 / distance of its nodes along d [1/A]                       */ \
    NUMBER(least_q)                                                                             \
    NUMBER(most_q)                                                                              \
    NUMBER(over_q)

#define FO_MAP_NUMBER(name) fo_real name;
typedef struct {
    fo_map_kind kind;
    bool magnets;          /* there is flux without a stator current (also of a cage)        */
    int32_t nodes_d;       /* table: coefficients along i_d, intervals + 2                   */
    int32_t nodes_q;
    FO_MAP_FIELDS(FO_MAP_NUMBER)
    const fo_real *coefficients; /* [nodes_d][nodes_q][2] [Wb]                               */
} fo_map;

/* Flux in rotor coordinates, its derivatives, and the auxiliary flux at a current. */
typedef struct {
    fo_real flux[2];       /* [Wb]                                   */
    fo_real by_d[2];       /* derivative of the flux by i_d [H]      */
    fo_real by_q[2];       /* derivative of the flux by i_q [H]      */
    fo_real auxiliary[2];  /* auxiliary flux a [Wb]                  */
    bool outside;          /* extrapolated linearly from the border  */
} fo_mapped;

/* Evaluates the map at a current in rotor coordinates [A]. `rotor_flux` is that of a cage [Wb]. */
void fo_map_at(const fo_map *map, const fo_real current[2], fo_real rotor_flux, fo_mapped *at);

/* Is the map well formed: are all numbers finite, and is the table consistent? */
bool fo_map_good(const fo_map *map);

/* Cosine and sine of an angle in (-pi, pi], to within 2e-9. */
void fo_direction(fo_real angle, fo_real direction[2]);

#ifdef __cplusplus
}
#endif

#endif
