#include "arrays.h"

#include <stdlib.h>
#include <string.h>

#include "estimate.h"

/* Numbers about the posterior. */
#define FO_OF_A_LOG(NUMBER)                                                                     \
    NUMBER(harmonics) NUMBER(objective) NUMBER(mean_square) NUMBER(conflict) NUMBER(evaluations) \
    NUMBER(converged)

#define COUNT(name) +1
const fo_sizes fo_log_sizes = {FO_UNKNOWNS, FO_LEVELS, 0 FO_FILE_FIELDS(COUNT), 0 FO_OF_A_ROW(COUNT),
                               0 FO_OF_A_LOG(COUNT), FO_QUANTITIES, FO_SHARES};
#undef COUNT

#define NAME(name) #name " "
const char fo_parameter_names[] = FO_OF_LEVELS(NAME) FO_OF_COLOUR(NAME) FO_OF_MODEL(NAME) FO_OF_MEANS(NAME);
const char fo_file_names[] = FO_FILE_FIELDS(NAME);
const char fo_row_names[] = FO_OF_A_ROW(NAME);
const char fo_log_names[] = FO_OF_A_LOG(NAME);
const char fo_map_fields[] = FO_MAP_FIELDS(NAME);
const char fo_orders[] = FO_HARMONICS(NAME);
#undef NAME

static void take_file(const double *numbers, fo_file *file)
{
#define TAKE(name) file->name = *numbers++;
    FO_FILE_FIELDS(TAKE)
#undef TAKE
}

static void take_map(const fo_log_arrays *in, fo_map *map)
{
    const double *next = in->map;
    memset(map, 0, sizeof *map);
#define TAKE(name) map->name = (fo_real)*next++;
    FO_MAP_FIELDS(TAKE)
#undef TAKE
    map->kind = (fo_map_kind)in->kind;
    map->magnets = in->magnets != 0;
    map->nodes_d = (int32_t)in->nodes_d;
    map->nodes_q = (int32_t)in->nodes_q;
    map->coefficients = in->coefficients;
}

int fo_estimate_arrays_of_log(const fo_log_arrays *in, double *parameters, double *covariance, double *about,
                              double *rows, double *shares)
{
    const fo_log log = {.rows = in->rows,
                        .sample_time = in->sample_time,
                        .voltage = in->voltage,
                        .current = in->current};
    fo_map map;
    fo_file file = {.map = in->kind < 0 ? NULL : &map};
    take_file(in->file, &file);
    if (file.map) take_map(in, &map);
    fo_posterior *posterior = malloc(sizeof *posterior);
    if (!posterior) return -1;
    /* Rows and shares are structs and arrays of numbers. */
    const fo_estimates estimates = {(fo_smoothed *)(void *)rows, (fo_shares *)(void *)shares, in->stride};
    const fo_outcome outcome =
        fo_estimate_log(&log, &file, in->hints, in->sure != 0, parameters, posterior, &estimates);
    memcpy(parameters, posterior->parameters, sizeof posterior->parameters);
    memcpy(covariance, posterior->covariance, sizeof posterior->covariance);
#define TELL(name) *about++ = (double)posterior->name;
    FO_OF_A_LOG(TELL)
#undef TELL
    free(posterior);
    return outcome == FO_NO_MEMORY ? -1 : outcome == FO_ESTIMATED;
}
