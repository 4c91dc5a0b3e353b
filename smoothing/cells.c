#include "cells.h"

#include <stdlib.h>
#include <string.h>

/* Size of a cell: shares of a turn, of the usual speed, and of the rated current. The 7th harmonic
 * in rotor coordinates has the period of four sectors. */
#define SECTORS 24.0
#define SPEED_STEP 0.15
#define CURRENT_STEP 0.15

#define TURN 6.283185307179586

typedef struct {
    int32_t sector, speed, d, q;
} key;

static int32_t whole(double x) { return (int32_t)floor(clamp(x, -1e6, 1e6) + 0.5); }

static key key_of(const fo_model *m, const fo_block_facts *b, double usual_speed)
{
    const double step = 1.0 / (CURRENT_STEP * m->current);
    const key k = {(int32_t)floor((b->angle / TURN + 0.5) * SECTORS),
                   whole(b->speed / (SPEED_STEP * usual_speed)), whole(b->current.re * step),
                   whole(b->current.im * step)};
    return k;
}

static size_t hash(key k)
{
    uint64_t x = (uint64_t)(uint32_t)k.sector;
    x = x * 0x9E3779B97F4A7C15u + (uint64_t)(uint32_t)k.speed;
    x = x * 0x9E3779B97F4A7C15u + (uint64_t)(uint32_t)k.d;
    x = x * 0x9E3779B97F4A7C15u + (uint64_t)(uint32_t)k.q;
    x ^= x >> 29;
    return (size_t)(x * 0x9E3779B97F4A7C15u >> 20);
}

bool fo_find_cells(const fo_work *w, const double *spread, double usual_speed, fo_cells *cells)
{
    size_t size = 16;
    while (size < 2 * w->blocks) size *= 2;
    key *keys = malloc(size * sizeof *keys);
    int32_t *place = malloc(size * sizeof *place);
    cells->count = 0;
    cells->of = malloc(w->blocks * sizeof *cells->of);
    const bool good = keys != NULL && place != NULL && cells->of != NULL;
    if (good) {
        memset(place, 0xff, size * sizeof *place); /* -1: empty */
        for (size_t b = 0; b < w->blocks; b++) {
            cells->of[b] = -1;
            bool measures = false;
            for (size_t n = 0; n < w->measurements; n++)
                measures = measures || isfinite(spread[b * w->measurements + n]);
            if (!measures) continue;
            const key k = key_of(w->model, &w->about[b], usual_speed);
            size_t at = hash(k) & (size - 1);
            while (place[at] >= 0 && memcmp(&keys[at], &k, sizeof k) != 0) at = (at + 1) & (size - 1);
            if (place[at] < 0) {
                place[at] = (int32_t)cells->count++;
                keys[at] = k;
            }
            cells->of[b] = place[at];
        }
    }
    free(keys);
    free(place);
    return good;
}

void fo_free_cells(fo_cells *cells)
{
    free(cells->of);
    cells->of = NULL;
}
