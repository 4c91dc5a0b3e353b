/* Interface of the estimate for hosts that pass arrays: Python and the page. */
#ifndef FLUXOBS_ARRAYS_H
#define FLUXOBS_ARRAYS_H

#include "estimate.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers about what was learnt. */
enum { FO_ABOUT_MISFIT, FO_ABOUT_CORRELATION, FO_ABOUT_COST, FO_ABOUT_SCALE, FO_ABOUT_SETTLED, FO_ABOUT_NOISE, FO_ABOUT_LEFT_OUT, FO_ABOUT };

/* Names, separated by spaces: of the assumptions, the fields of fo_model and of fo_map, and the
 * outputs of a row. */
extern const char fo_assumption_names[], fo_model_names[], fo_map_names[], fo_smoothed_names[];

typedef struct {
    const double *numbers;      /* fields of fo_model */
    const double *std;          /* FO_P priors */
    const double *map;          /* fields of fo_map */
    const double *coefficients; /* its table, nodes_d * nodes_q * 2 */
    int kind, nodes_d, nodes_q;
    size_t rows;
    const double *voltage, *current; /* rows * 2 */
    const uint8_t *flags;            /* rows, see fo_record */
    const double *angle, *angle_std; /* rows */
    int learning;
} fo_arrays;

/* `p`: FO_P, `covariance`: active * active, `about`: FO_ABOUT; where learning starts, and results.
 * `columns`: FO_S * rows, `known`: rows, `budget`: blocks * FO_QUANTITIES *
 * FO_BUDGET; results. 0: no memory, or stopped. */
int fo_estimate_arrays(const fo_arrays *in, double *p, double *covariance, double *about,
                       double *columns, uint8_t *known, double *budget);

/* Rows of a block of a log with this sample time [s] and usual speed [rad/s]. */
size_t fo_block_rows(double sample_time, double speed);

#ifdef __cplusplus
}
#endif
#endif
