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

/* Errors of the state, in the coordinates of the estimated rotor: there the matrices of the filter
 * depend on the parameters, on the speed and on i_dq only, and change slowly. */
enum {
    FO_FLUX_D,
    FO_FLUX_Q,
    FO_ANGLE,
    FO_SPEED,
    FO_ACCELERATION,
    FO_GAIN,
    FO_DRIFT_D,
    FO_DRIFT_Q,
    FO_NOISE_D,
    FO_NOISE_Q,
    FO_STATES
};

/* A log of a synchronous machine with constant inductances. */
typedef struct {
    size_t rows;
    double sample_time;    /* [s] */
    /* rows × 2, NaN where they are missing: mean from this row to the next, with the log's lag [V] */
    const double *voltage;
    const double *current; /* [A] */
} fo_log;

/* State at the first row, with standard deviations. The flux is that of the measured current. */
typedef struct {
    double angle, angle_std; /* [rad] */
    double speed, speed_std; /* [rad/s] */
    double acceleration_std; /* [rad/s²] */
    double flux_std;         /* of a component [Wb] */
    double drift_std;        /* of a component [V] */
    double gain_std;         /* of the voltage's gain [1] */
    size_t skipped;          /* rows until the innovations count */
    double price; /* of losing the rotor and starting again at a row [half squares]; 0: never */
} fo_start;

typedef struct {
    double objective;          /* ½ Σ eᵀS⁻¹e + ln det S, without constant */
    double score[FO_UNKNOWNS]; /* its derivative */
    double information[FO_UNKNOWNS * FO_UNKNOWNS]; /* expected second derivative (Fisher) */
    double mean_square; /* of the normalised innovations; 1 if the levels are right */
    size_t counted;     /* rows */
    size_t losses;      /* times that the filter lost the rotor */
} fo_likelihood;

/* What the filter knows at a row, for smoothing backwards. */
typedef struct {
    double angle, speed;             /* after the measurement */
    double P[FO_STATES][FO_STATES];  /* covariance, after it */
    double error[2], inverse[2][2];  /* innovation, and the inverse of its covariance */
    double K[FO_STATES][2];          /* Kalman gain */
    double H[2][FO_STATES];          /* derivative of the measurement */
    double F[FO_STATES][FO_STATES];  /* transition to the next row */
    double error_by[2][FO_UNKNOWNS]; /* derivatives of the innovation by the parameters */
    double state_by[2][FO_UNKNOWNS]; /* derivatives of angle and speed */
    bool measured;
} fo_row;

/* `parameters`: FO_L, then two coefficients of each harmonic [Wb]; the last unknown is that of
 * `start`, and the derivatives are by its change. `kept`: an element for each row, or null.
 * False: a number is not finite, or a covariance is not positive. */
bool fo_innovations(const fo_log *log, const double parameters[FO_UNKNOWNS], const fo_start *start,
                    fo_likelihood *out, fo_row *kept);

/* Whether the filter has lost the rotor at a row: `recent` is the running mean of the normalised
 * squares, 1 at first. */
bool fo_is_lost(const fo_row *row, double *recent);

#ifdef __cplusplus
}
#endif
#endif
