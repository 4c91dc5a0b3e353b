/* The machine's relation |x| = psi_f + saliency i_d and its derivatives; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_RELATION_H
#define FLUXOBS_RELATION_H

#include "fluxobs_adaptive.h"

#define fo_linearise FO_NAME(fo_linearise)
#define fo_residual_gradients FO_NAME(fo_residual_gradients)

/* Position vector at which the relation is linearised. */
typedef struct {
    fo_real current[FO_N];      /* current without offset                                    */
    fo_real x[FO_N], length;    /* position vector                                           */
    fo_real direction[FO_N];    /* direction of the position vector: the d axis              */
    fo_real armature_flux[2];   /* flux of the current along d, q                            */
    fo_real length_by_current;  /* part of the length due to the current: saliency           */
} fo_linearisation;

/* Linearises at this flux and measured current, with these errors of the parameters [their units].
 * `map` is the map linearised at the same current; it is not used without a flux map. */
void fo_linearise(const fo_adaptive *observer, const fo_real value[FO_NP],
                  const fo_real flux[FO_N], const fo_real current[FO_N], const fo_map_point *map,
                  fo_linearisation *point);

/* Gradient of the residual by the flux, and negative gradient by the current. */
void fo_residual_gradients(const fo_adaptive *observer, const fo_map_point *map,
                           const fo_linearisation *point, fo_real by_flux[FO_N],
                           fo_real by_current[FO_N]);

#endif
