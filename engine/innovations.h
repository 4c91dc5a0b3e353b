/* The likelihood of a log's currents, from their prediction errors (innovations).
 *
 * The measurement is the current: i_k = f(λ_k, θ_k) + n_k. The applied voltages and the *predicted*
 * current (R i, loss of the inverter) drive the flux λ. So the noise of a row enters once, in the
 * row's innovation, and the score has mean zero at the true parameters although a controller
 * answers the noise. Derivation: docs/theory.md, section 20. */
#ifndef FLUXOBS_INNOVATIONS_H
#define FLUXOBS_INNOVATIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "parameters.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A log of a synchronous machine with constant inductances. */
typedef struct {
    size_t rows;
    double sample_time;    /* [s] */
    const double *voltage; /* rows × 2: mean from this row to the next, with the log's lag [V] */
    const double *current; /* rows × 2, NaN where it is missing [A] */
    double knee;           /* current at which the loss reaches 76 % of its value [A]; 0: no loss */
} fo_log;

/* State at the first row, with standard deviations. The flux is that of the measured current. */
typedef struct {
    double angle, angle_std; /* [rad] */
    double speed, speed_std; /* [rad/s] */
    double flux_std;         /* of a component [Wb] */
    double drift_std;        /* of a component [V] */
    size_t skipped;          /* rows until the innovations count */
} fo_start;

typedef struct {
    double objective;                /* ½ Σ eᵀS⁻¹e + ln det S, without constant */
    double score[FO_L];              /* its derivative */
    double information[FO_L * FO_L]; /* expected second derivative (Fisher) */
    double mean_square;              /* of the normalised innovations; 1 if the levels are right */
    size_t counted;                  /* rows */
} fo_likelihood;

/* `angle`, rows numbers, or null: the filter's angle at each row, after its measurement. False: a
 * number is not finite, or a covariance is not positive. */
bool fo_innovations(const fo_log *log, const double parameters[FO_L], const fo_start *start,
                    fo_likelihood *out, double *angle);

#ifdef __cplusplus
}
#endif
#endif
