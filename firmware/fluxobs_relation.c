/* SPDX-License-Identifier: MIT */
#include "fluxobs_relation.h"

#include "fluxobs_internal.h"

void fo_linearise(const fo_adaptive *a, const fo_real value[FO_NP], const fo_real flux[FO_N],
                  const fo_real current[FO_N], const fo_map_point *map, fo_linearisation *point)
{
    const fo_observer *o = &a->plain;
    const fo_real L_d = o->L_position + a->saliency, L_q = o->L_position;
    const fo_real wrong_d = value[FO_INDUCTANCE], wrong_q = value[FO_INDUCTANCE + 1];
    const fo_real L_estimated = L_q + wrong_q * L_q;
    for (int i = 0; i < FO_N; i++) {
        const fo_real offset = value[FO_OFFSET + i];
        point->current[i] = current[i] - offset;
        point->x[i] = flux[i] - L_estimated * point->current[i];
#if FO_MAPPED
        if (has_map(o)) {
            point->x[i] = flux[i] - (map->armature_flux[i] - L_q * offset);
        }
#endif
    }
#if FO_MAPPED
    if (has_map(o)) {
        point->length_by_current = map->active_flux - o->map->psi / o->flux_base;
        point->armature_flux[0] = dot(map->direction, map->armature_flux) +
                                  (has_cage_map(o) ? ZERO : point->length_by_current);
        point->armature_flux[1] = component_across(map->direction, map->armature_flux);
        point->x[0] += wrong_q * point->armature_flux[1] * map->direction[1];
        point->x[1] -= wrong_q * point->armature_flux[1] * map->direction[0];
    }
#else
    (void)map;
#endif
    point->length = fo_sqrt(dot(point->x, point->x));
    const fo_real over = ONE / point->length;
    point->direction[0] = point->x[0] * over;
    point->direction[1] = point->x[1] * over;
#if FO_MAPPED
    if (has_map(o)) { /* convert from the direction of the map's linearisation to the present
                       * direction */
        const fo_real off = component_across(map->direction, point->direction) * point->length;
        point->length_by_current += wrong_d * point->armature_flux[0] -
                                    component_across(map->direction, map->by_flux) * off;
    } else
#endif
    {
        const fo_real i_d = dot(point->direction, point->current);
        point->armature_flux[0] = L_d * i_d;
        point->armature_flux[1] = L_q * component_across(point->direction, point->current);
        point->length_by_current = (a->saliency + wrong_d * L_d - wrong_q * L_q) * i_d;
    }
}

void fo_residual_gradients(const fo_adaptive *a, const fo_map_point *map,
                           const fo_linearisation *point, fo_real by_flux[FO_N],
                           fo_real by_current[FO_N]) {
#if FO_MAPPED
    if (has_map(&a->plain)) {
        for (int i = 0; i < FO_N; i++) {
            by_flux[i] = map->by_flux[i];
            by_current[i] = map->by_current[i];
        }
    } else
#else
    (void)map;
#endif
    {
        const fo_real i_q = component_across(point->direction, point->current);
        const fo_real turned = a->saliency * i_q / point->length;
        by_flux[0] = point->direction[0] + turned * point->direction[1];
        by_flux[1] = point->direction[1] - turned * point->direction[0];
        for (int i = 0; i < FO_N; i++) {
            by_current[i] = a->plain.L_position * by_flux[i] + a->saliency * point->direction[i];
        }
    }
}
