/* Interface of the estimate for hosts that pass arrays: Python and the page. */
#ifndef FLUXOBS_LOG_ARRAYS_H
#define FLUXOBS_LOG_ARRAYS_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How many there are: unknowns and the first that change only covariances, numbers of a file, a row and a log,
 * quantities with shares, and their shares. */
typedef struct {
    size_t unknowns, levels, file, row, log, quantities, shares;
} fo_sizes;
extern const fo_sizes fo_log_sizes;

/* Names, separated by spaces: of the parameters, the fields of fo_file and of fo_map, the numbers of a row and of a log.
 * Two coefficients of each harmonic follow the parameters; fo_orders names the harmonics. */
extern const char fo_parameter_names[], fo_file_names[], fo_row_names[], fo_log_names[], fo_orders[], fo_map_fields[];

typedef struct {
    const double *file;         /* numbers of a file */
    int kind;                   /* of the flux map; negative: none */
    int magnets;                /* there is flux without a stator current */
    const double *map;          /* fields of fo_map */
    const double *coefficients; /* its table, nodes_d * nodes_q * 2 */
    int nodes_d, nodes_q;
    size_t rows;
    double sample_time;
    const double *voltage, *current; /* rows * 2 */
    const double *hints;             /* rows, see fo_estimate_log */
    int sure;
    size_t stride; /* of the rows with shares */
} fo_log_arrays;

/* `parameters`: of the unknowns, where learning starts and results; `covariance`: its square; `about`: numbers of the
 * log; `rows`: those of each row; `shares`: rows / stride, rounded up, * quantities * shares, zero before. Returns 1;
 * 0: no estimate; -1: no memory. */
int fo_estimate_arrays_of_log(const fo_log_arrays *in, double *parameters, double *covariance, double *about,
                              double *rows, double *shares);

/* Not zero: what runs ends soon, without an estimate. */
extern volatile int fo_interrupted;

#ifdef __cplusplus
}
#endif
#endif
