#include "arrays.h"

#include <stdlib.h>
#include <string.h>

#define NAME(name) #name " "
const char fo_assumption_names[] = FO_ASSUMPTIONS(NAME);
const char fo_model_names[] = FO_MODEL_FIELDS(NAME);
const char fo_map_names[] = FO_MAP_FIELDS(NAME);
const char fo_smoothed_names[] = FO_SMOOTHED_FIELDS(NAME);
#undef NAME

static void take(const fo_arrays *in, fo_model *m)
{
    const double *next = in->numbers;
    memset(m, 0, sizeof *m);
#define TAKE(name) m->name = *next++;
    FO_MODEL_FIELDS(TAKE)
#undef TAKE
    next = in->map;
#define TAKE(name) m->map.name = *next++;
    FO_MAP_FIELDS(TAKE)
#undef TAKE
    memcpy(m->std, in->std, sizeof m->std);
    m->map.kind = (fo_map_kind)in->kind;
    m->map.nodes_d = (int32_t)in->nodes_d;
    m->map.nodes_q = (int32_t)in->nodes_q;
    m->map.coefficients = in->coefficients;
}

int fo_estimate_arrays(const fo_arrays *in, double *p, double *covariance, double *about,
                       double *columns, uint8_t *known, double *budget)
{
    fo_model model;
    take(in, &model);
    size_t active = 0;
    for (int j = 0; j < FO_P; j++)
        if (model.std[j] > 0.0) active++;
    const size_t bytes = active * active * sizeof *covariance;
    /* A vector is two numbers. */
    const fo_record record = {in->rows,     (const vec *)(const void *)in->voltage,
                              (const vec *)(const void *)in->current,
                              in->flags, in->angle,
                              in->angle_std};
    const fo_estimates out = {columns, known, budget};
    fo_assumed *learnt = calloc(1, sizeof *learnt);
    if (learnt == NULL) return 0;
    memcpy(learnt->p, p, sizeof learnt->p);
    memcpy(learnt->covariance, covariance, bytes);
    learnt->filter_scale = about[FO_ABOUT_SCALE];
    const bool good = fo_estimate_rows(&model, &record, in->learning != 0, learnt, &out);
    memcpy(p, learnt->p, sizeof learnt->p);
    memcpy(covariance, learnt->covariance, bytes);
    about[FO_ABOUT_MISFIT] = learnt->chi;
    about[FO_ABOUT_CORRELATION] = learnt->correlation;
    about[FO_ABOUT_COST] = learnt->cost;
    about[FO_ABOUT_SCALE] = learnt->filter_scale;
    about[FO_ABOUT_SETTLED] = learnt->settled ? 1.0 : 0.0;
    about[FO_ABOUT_NOISE] = learnt->noise;
    about[FO_ABOUT_LEFT_OUT] = learnt->left_out ? 1.0 : 0.0;
    free(learnt);
    return good;
}

size_t fo_block_rows(double sample_time, double speed)
{
    fo_model m;
    memset(&m, 0, sizeof m);
    m.sample_time = sample_time;
    m.speed = speed;
    return fo_rows_per_block(&m);
}
