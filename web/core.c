/* Interface of the observers for a WebAssembly host: it has memory, names and offsets of fields,
 * and runs over rows. All field names come from the lists in the C headers. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "columns.h"
#include "fluxobs_config.h"
#include "fluxobs_internal.h"

#define EXPORT(name) __attribute__((export_name(#name))) name

typedef struct {
    const char *name;
    uint32_t offset; /* [bytes] */
    uint32_t count;  /* numbers */
} field;

#define PLACE(type, name) {#name, (uint32_t)offsetof(type, name), (uint32_t)(sizeof(((type *)0)->name) / sizeof(fo_real))},
#define CONFIG(name) PLACE(fo_config, name)
#define CONFIG_POSITIVE(name, least, most) PLACE(fo_config, name)
#define ADAPTIVE(name) PLACE(fo_adaptive_config, name)
#define MAP(name) PLACE(fo_map, name)
#define LEARNT(name) PLACE(fo_learnt, name)
#define VECTOR_OUTPUT(name) {#name, 0, FO_N},
#define NUMBER_OUTPUT(name) {#name, 0, 1},
#define MEMBER_OUTPUT(member, name) {#name, 0, 1},
#define SIZE(name) PLACE(fo_sizes, name)
#define USUAL(name, value) {#name, 0, 1},
#define USUAL_VALUE(name, value) (double)(value),
#define THRESHOLD(name) {#name, 0, 1},
#define THRESHOLD_VALUE(name) (double)(name),

static const field config_fields[] = {FO_CONFIG_FIELDS(CONFIG, CONFIG, CONFIG, CONFIG_POSITIVE){0, 0, 0}};
static const field adaptive_fields[] = {FO_ADAPTIVE_CONFIG_FIELDS(ADAPTIVE){0, 0, 0}};
static const field map_fields[] = {FO_MAP_FIELDS(MAP){0, 0, 0}};
static const field learnt_fields[] = {FO_LEARNT_FIELDS(LEARNT, LEARNT){0, 0, 0}};
static const field plain_outputs[] = {FO_ESTIMATE_FIELDS(VECTOR_OUTPUT, NUMBER_OUTPUT){0, 0, 0}};
static const field adaptive_outputs[] = {
    FO_ESTIMATE_FIELDS(VECTOR_OUTPUT, NUMBER_OUTPUT) ADAPTIVE_ESTIMATE_FIELDS(MEMBER_OUTPUT){0, 0, 0}};
static const field threshold_names[] = {FO_THRESHOLDS(THRESHOLD){0, 0, 0}};
static const field sizes_fields[] = {FO_SIZES_FIELDS(SIZE){0, 0, 0}};
static const field usual_names[] = {FO_USUAL(USUAL){0, 0, 0}};
static const double usual_values[] = {FO_USUAL(USUAL_VALUE)};
static const double threshold_values[] = {FO_THRESHOLDS(THRESHOLD_VALUE)};

/* Each list ends with a null name. */
const field *EXPORT(fields)(int of)
{
    static const field *const lists[] = {config_fields, adaptive_fields, map_fields,
                                         learnt_fields, plain_outputs,   adaptive_outputs,
                                         threshold_names, sizes_fields,  usual_names};
    return lists[of];
}

const double *EXPORT(values)(int usual) { return usual ? usual_values : threshold_values; }

uint32_t EXPORT(size_of)(int what)
{
    static const uint32_t sizes[] = {sizeof(fo_config),   sizeof(fo_adaptive_config), sizeof(fo_map),
                                     sizeof(fo_learnt),   sizeof(fo_observer),        sizeof(fo_adaptive),
                                     sizeof(fo_state),    sizeof(fo_adaptive_state),  COLUMNS,
                                     ADAPTIVE_COLUMNS,    sizeof(fo_sizes)};
    return sizes[what];
}

void EXPORT(choose)(fo_config *config, const fo_sizes *sizes, double sample_time, double memory,
                    double current_noise, double drift_prior)
{
    config->sample_time = sample_time;
    config->memory = memory;
    config->current_noise = current_noise;
    config->drift_prior = drift_prior;
    fo_choose(config, sizes, FO_VOLTAGE_AUTO);
}
void EXPORT(kink_weights)(double share, double weights[2]) { fo_kink_weights(share, weights); }

void *EXPORT(allocate)(uint32_t bytes) { return calloc(1, bytes); }
void EXPORT(release)(void *memory) { free(memory); }

void EXPORT(shape_map)(fo_map *map, int kind, int magnets, int nodes_d, int nodes_q,
                       const fo_real *coefficients)
{
    map->kind = (fo_map_kind)kind;
    map->magnets = magnets != 0;
    map->nodes_d = nodes_d;
    map->nodes_q = nodes_q;
    map->coefficients = coefficients;
}

/* make_plain and make_adaptive prepare an observer and return an fo_error; `map` may be null. */
int EXPORT(make_plain)(fo_observer *observer, const fo_config *config, const fo_map *map)
{
    const fo_error error = fo_init(observer, config);
    return (int)(error == FO_OK && map ? fo_use_map(observer, map) : error);
}

int EXPORT(make_adaptive)(fo_adaptive *observer, const fo_config *config, fo_adaptive_config *adaptive,
                          int projection, const fo_map *map)
{
    adaptive->projection = (fo_projection)projection;
    const fo_error error = fo_adaptive_init(observer, config, adaptive);
    return (int)(error == FO_OK && map ? fo_use_map(&observer->plain, map) : error);
}

void EXPORT(reset_plain)(const fo_observer *observer, fo_state *state) { fo_reset(observer, state); }
void EXPORT(reset_adaptive)(const fo_adaptive *observer, fo_adaptive_state *state)
{
    fo_adaptive_reset(observer, state);
}

/* Processes rows of source [2] and current [2]. Writes columns [COLUMNS][rows] and valid [rows]. */
void EXPORT(run_plain)(const fo_observer *observer, fo_state *state, const fo_real *source,
                       const fo_real *current, uint32_t rows, int volt_seconds, double *columns,
                       uint8_t *valid)
{
    for (uint32_t k = 0; k < rows; k++) {
        fo_estimate e;
        if (volt_seconds)
            fo_step_volt_seconds(observer, state, source + FO_N * k, current + FO_N * k, &e);
        else
            fo_step(observer, state, source + FO_N * k, current + FO_N * k, &e);
        write_plain(&e, columns + k, rows);
        valid[k] = e.valid;
    }
}

void EXPORT(run_adaptive)(const fo_adaptive *observer, fo_adaptive_state *state, const fo_real *source,
                          const fo_real *current, uint32_t rows, int volt_seconds, double *columns,
                          uint8_t *valid)
{
    for (uint32_t k = 0; k < rows; k++) {
        fo_adaptive_estimate e;
        if (volt_seconds)
            fo_adaptive_step_volt_seconds(observer, state, source + FO_N * k, current + FO_N * k, &e);
        else
            fo_adaptive_step(observer, state, source + FO_N * k, current + FO_N * k, &e);
        write_adaptive(&e, columns + k, rows);
        valid[k] = e.position.valid;
    }
}

/* bad_voltages, bad_currents, absurd, outliers, restarts, outside */
void EXPORT(counters)(const void *state, int adaptive, uint32_t counts[6])
{
    const fo_state *of = adaptive ? &((const fo_adaptive_state *)state)->plain : (const fo_state *)state;
    const uint32_t found[6] = {of->bad_voltages, of->bad_currents, of->absurd,
                               of->outliers,     of->restarts,     of->outside};
    memcpy(counts, found, sizeof found);
}

void EXPORT(learnt)(const fo_adaptive *observer, const fo_adaptive_state *state, fo_learnt *found)
{
    fo_adaptive_learnt(observer, state, found);
}
void EXPORT(restart)(const fo_adaptive *observer, fo_adaptive_state *state, int frozen)
{
    fo_adaptive_restart(observer, state, frozen != 0);
}
uint32_t EXPORT(restarts)(const fo_adaptive_state *state) { return state->restarts; }
