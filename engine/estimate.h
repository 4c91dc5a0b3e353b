/* Angle, speed and parameters of a whole log of a synchronous machine, from any start. */
#ifndef FLUXOBS_ESTIMATE_H
#define FLUXOBS_ESTIMATE_H

#include "posterior.h"
#include "smoothed.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    FO_ESTIMATED,
    FO_NO_ESTIMATE, /* the likelihood cannot be evaluated: the log contradicts every start */
    FO_NO_MEMORY
} fo_outcome;

/* Machine file: values, and relative standard deviations (logarithms); a std of zero is exact. */
typedef struct {
    double R, L_d, L_q, psi_f, rated_current;
    double R_std, L_std, psi_std;
    double lag, lag_std; /* that the voltages act later than the log says [samples] */
} fo_file;

/* Priors of an ordinary drive. The levels scale with the log's mean voltage and the rated current. */
fo_prior fo_ordinary_prior(const fo_log *log, const fo_file *file);

/* Estimates: the fastest part of the log first, from the direction of its voltages; then parts that
 * contain it, each twice as long, up to the whole log. `rows`: an element for each row. */
fo_outcome fo_estimate(const fo_log *log, const fo_file *file, fo_posterior *posterior,
                       fo_smoothed *rows);

#ifdef __cplusplus
}
#endif
#endif
