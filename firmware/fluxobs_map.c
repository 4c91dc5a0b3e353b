/* SPDX-License-Identifier: MIT */
#include "fluxobs_map.h"

#include "fluxobs_internal.h"

enum { D = 0, Q = 1, ORDER = 3 };

/* sin(x), |x| <= pi/2: Abramowitz and Stegun, 4.3.97. */
static fo_real sine_of(fo_real x)
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
    const fo_real up = sine_of(folded);
    direction[0] = sine_of(PI / TWO - size);
    direction[1] = angle < ZERO ? -up : up;
}

/* Cell of a current in the table: index of the first of three coefficients, and weights of the
 * first and the last coefficient relative to the middle one, for the value and for its
 * derivative. */
typedef struct {
    int32_t first;
    fo_real low, high, slope_low, slope_high;
} cell;

/* Locates a current along one axis of the table. Returns its distance outside the table [A]. */
static fo_real locate(fo_real current, fo_real least, fo_real most, fo_real over, int32_t nodes,
                    cell *p)
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

static fo_real value(const cell *p, fo_real low, fo_real middle, fo_real high)
{
    return middle + p->low * (low - middle) + p->high * (high - middle);
}

static fo_real slope(const cell *p, fo_real low, fo_real middle, fo_real high)
{
    return p->slope_low * (low - middle) + p->slope_high * (high - middle);
}

static void evaluate_table(const fo_map *map, const fo_real current[2], fo_mapped *answer)
{
    cell d, q;
    const fo_real beyond[2] = {
        locate(current[D], map->least_d, map->most_d, map->over_d, map->nodes_d, &d),
        locate(current[Q], map->least_q, map->most_q, map->over_q, map->nodes_q, &q)};
    const fo_real *c = &map->coefficients[2 * (d.first * map->nodes_q + q.first)];
    for (int n = 0; n < 2; n++) {
        const fo_real *low = &c[n], *middle = &low[2 * map->nodes_q];
        const fo_real *high = &middle[2 * map->nodes_q];
        const fo_real along[ORDER] = {value(&q, low[0], low[2], low[4]),
                                      value(&q, middle[0], middle[2], middle[4]),
                                      value(&q, high[0], high[2], high[4])};
        answer->flux[n] = value(&d, along[0], along[1], along[2]);
        answer->by_d[n] = slope(&d, along[0], along[1], along[2]);
        answer->by_q[n] = value(&d, slope(&q, low[0], low[2], low[4]),
                            slope(&q, middle[0], middle[2], middle[4]),
                            slope(&q, high[0], high[2], high[4]));
    }
    answer->outside = !(beyond[D] == ZERO && beyond[Q] == ZERO);
    if (answer->outside) {
        for (int n = 0; n < 2; n++) {
            answer->flux[n] += beyond[D] * answer->by_d[n] + beyond[Q] * answer->by_q[n];
        }
    }
}

void fo_map_at(const fo_map *map, const fo_real current[2], fo_real rotor_flux, fo_mapped *answer)
{
    if (map->kind == FO_MAP_TABLE) {
        evaluate_table(map, current, answer);
    } else {
        const fo_real psi = map->kind == FO_MAP_CAGE ? rotor_flux : map->psi;
        answer->by_d[D] = map->L_d;
        answer->by_d[Q] = ZERO;
        answer->by_q[D] = ZERO;
        answer->by_q[Q] = map->L_q;
        answer->flux[D] = psi + map->L_d * current[D];
        answer->flux[Q] = map->L_q * current[Q];
        answer->outside = false;
    }
    answer->auxiliary[D] =
        answer->flux[D] + answer->by_d[Q] * current[Q] - answer->by_q[Q] * current[D];
    answer->auxiliary[Q] =
        answer->flux[Q] - answer->by_d[D] * current[Q] + answer->by_q[D] * current[D];
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
        /* a linear map may have any finite numbers */
    }
    return good;
}
