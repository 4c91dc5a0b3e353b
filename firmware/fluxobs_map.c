/* SPDX-License-Identifier: MIT */
#include "fluxobs_map.h"

#include "fluxobs_internal.h"

enum { D = 0, Q = 1, ORDER = 3 };

/* sin(x), |x| <= pi/2. Abramowitz and Stegun, 4.3.97. */
static fo_real rising(fo_real x)
{
    const fo_real s = x * x;
    return x * (ONE + s * ((fo_real)-.1666666664 +
                           s * ((fo_real).0083333315 +
                                s * ((fo_real)-.0001984090 +
                                     s * ((fo_real).0000027526 + s * (fo_real)-.0000000239)))));
}

void fo_direction(fo_real angle, fo_real direction[2])
{
    const fo_real size = fo_abs(angle);
    const fo_real folded = size > PI / TWO ? PI - size : size;
    const fo_real up = rising(folded);
    direction[0] = rising(PI / TWO - size);
    direction[1] = angle < ZERO ? -up : up;
}

/* Where a current is in a table: the first of its three coefficients, and the weights of the first
 * and the last against the middle one, for the value and for its derivative. */
typedef struct {
    int32_t first;
    fo_real low, high, slope_low, slope_high;
} place;

/* Returns how far outside the table the current is [A]. */
static fo_real find(fo_real current, fo_real least, fo_real most, fo_real over, int32_t nodes,
                    place *p)
{
    const fo_real inside = !(current > least) ? least : current > most ? most : current;
    const fo_real at = (inside - least) * over;
    const int32_t last = nodes - (int32_t)ORDER;
    int32_t first = (int32_t)at;
    first = first < last ? first : last;
    const fo_real t = at - (fo_real)first, u = ONE - t;
    p->first = first;
    p->low = u * u / TWO;
    p->high = t * t / TWO;
    p->slope_low = -u * over;
    p->slope_high = t * over;
    return current - inside;
}

static fo_real value(const place *p, fo_real low, fo_real middle, fo_real high)
{
    return middle + p->low * (low - middle) + p->high * (high - middle);
}

static fo_real slope(const place *p, fo_real low, fo_real middle, fo_real high)
{
    return p->slope_low * (low - middle) + p->slope_high * (high - middle);
}

static void look_up(const fo_map *map, const fo_real current[2], fo_mapped *at)
{
    place d, q;
    const fo_real off[2] = {
        find(current[D], map->least_d, map->most_d, map->over_d, map->nodes_d, &d),
        find(current[Q], map->least_q, map->most_q, map->over_q, map->nodes_q, &q)};
    const fo_real *c = &map->coefficients[2 * (d.first * map->nodes_q + q.first)];
    for (int n = 0; n < 2; n++) {
        const fo_real *low = &c[n], *middle = &low[2 * map->nodes_q];
        const fo_real *high = &middle[2 * map->nodes_q];
        const fo_real along[ORDER] = {value(&q, low[0], low[2], low[4]),
                                      value(&q, middle[0], middle[2], middle[4]),
                                      value(&q, high[0], high[2], high[4])};
        at->flux[n] = value(&d, along[0], along[1], along[2]);
        at->by_d[n] = slope(&d, along[0], along[1], along[2]);
        at->by_q[n] = value(&d, slope(&q, low[0], low[2], low[4]),
                            slope(&q, middle[0], middle[2], middle[4]),
                            slope(&q, high[0], high[2], high[4]));
    }
    at->outside = !(off[D] == ZERO && off[Q] == ZERO);
    if (at->outside) {
        for (int n = 0; n < 2; n++) {
            at->flux[n] += off[D] * at->by_d[n] + off[Q] * at->by_q[n];
        }
    }
}

void fo_map_at(const fo_map *map, const fo_real current[2], fo_real rotor_flux, fo_mapped *at)
{
    if (map->kind == FO_MAP_TABLE) {
        look_up(map, current, at);
    } else {
        const fo_real psi = map->kind == FO_MAP_CAGE ? rotor_flux : map->psi;
        at->by_d[D] = map->L_d;
        at->by_d[Q] = ZERO;
        at->by_q[D] = ZERO;
        at->by_q[Q] = map->L_q;
        at->flux[D] = psi + map->L_d * current[D];
        at->flux[Q] = map->L_q * current[Q];
        at->outside = false;
    }
    at->auxiliary[D] = at->flux[D] + at->by_d[Q] * current[Q] - at->by_q[Q] * current[D];
    at->auxiliary[Q] = at->flux[Q] - at->by_d[D] * current[Q] + at->by_q[D] * current[D];
}

static bool finite_number(fo_real x) { return x - x == ZERO; }

#define IS_FINITE(name) &&finite_number(map->name)

bool fo_map_good(const fo_map *map)
{
    bool good = true FO_MAP_FIELDS(IS_FINITE);
    if (map->kind == FO_MAP_TABLE) {
        good = good && map->nodes_d >= (int32_t)ORDER && map->nodes_q >= (int32_t)ORDER &&
               map->most_d > map->least_d && map->most_q > map->least_q && map->over_d > ZERO &&
               map->over_q > ZERO && map->coefficients != NULL;
        const int32_t count = good ? 2 * map->nodes_d * map->nodes_q : 0;
        for (int32_t i = 0; i < count; i++) {
            good = good && finite_number(map->coefficients[i]);
        }
    } else if (map->kind == FO_MAP_CAGE) {
        good = good && map->decay > ZERO && map->decay < ONE && map->still > ZERO &&
               map->ripple > ZERO;
    } else {
        /* any numbers will do */
    }
    return good;
}
