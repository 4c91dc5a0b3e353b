/* The likelihood of a log's currents, from their prediction errors (innovations).
 *
 * The measurement is the current: i_k = f(λ_k, θ_k) + n_k. The applied voltages and the *predicted*
 * current (R i, loss of the inverter) drive the flux λ. So the noise of a row enters once, in the
 * row's innovation, and the score has mean zero at the true parameters although a controller
 * answers the noise. The model is linearised about a course of flux and angle over the whole log,
 * not about the filter's own estimates: a filter that does not know the angle yet follows it all
 * the same, and smoothing gives the next course (Gauss–Newton). Derivation: docs/theory.md,
 * section 20. */
#ifndef FLUXOBS_INNOVATIONS_H
#define FLUXOBS_INNOVATIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "parameters.h"

#ifdef __cplusplus
extern "C" {
#endif

/* States; vectors in stator coordinates. The noise is the predictable part of coloured noise; it is
 * the last, so that white noise needs FO_WHITE states only. */
enum {
    FO_FLUX,
    FO_ANGLE = 2,
    FO_SPEED,
    FO_ACCELERATION,
    FO_DRIFT,
    FO_NOISE = 7,
    FO_WHITE = FO_NOISE,
    FO_STATES = 9
};
/* Those of the course and of the result: flux, angle, speed. */
enum { FO_OWN = 4 };
/* Elements of the transition that are not zero; see innovations.c. */
enum { FO_ELEMENTS = 31 };

/* A log of a synchronous machine with constant inductances. */
typedef struct {
    size_t rows;
    double sample_time;    /* [s] */
    /* rows × 2, NaN where they are missing: mean from this row to the next, with the log's lag [V] */
    const double *voltage;
    const double *current; /* [A] */
} fo_log;

/* Where the model is linearised at a row. */
typedef struct {
    double flux[2]; /* stator coordinates [Wb] */
    double angle;   /* without jumps of a turn [rad] */
    double unrest;  /* factor on the variance by which the acceleration changes until the next row */
} fo_course;

/* What is known before the first row: standard deviations about the course. */
typedef struct {
    double flux_std, angle_std; /* [Wb], [rad] */
    double speed_std;           /* [rad/s] */
    double acceleration_std;    /* [rad/s²] */
    double drift_std;           /* of a component [V] */
    size_t skipped;             /* rows until the innovations count */
} fo_start;

typedef struct {
    double objective;          /* ½ Σ eᵀS⁻¹e + ln det S, without constant */
    double score[FO_UNKNOWNS]; /* its derivative */
    double information[FO_UNKNOWNS * FO_UNKNOWNS]; /* expected second derivative (Fisher) */
    double mean_square; /* of the normalised innovations; 1 if the levels are right */
    size_t counted;     /* rows */
} fo_likelihood;

/* What the filter knows at a row, for smoothing backwards. */
typedef struct {
    double own[FO_OWN];              /* after the measurement */
    double P[FO_OWN][FO_STATES];     /* their covariances */
    double error[2], inverse[3];     /* innovation, inverse of its covariance: 00, 01, 11 */
    double K[FO_STATES][2];          /* Kalman gain */
    double by_flux[3], by_angle[2];  /* derivatives of the current: αα, αβ, ββ; α, β */
    double F[FO_ELEMENTS];           /* transition to the next row */
    double error_by[2][FO_UNKNOWNS]; /* derivatives of the innovation by the parameters */
    double own_by[2][FO_UNKNOWNS];   /* derivatives of angle and speed */
    bool measured;
} fo_row;

/* Rows and columns of the elements of the transition. */
extern const unsigned char fo_pattern[FO_ELEMENTS][2];

/* `parameters`: FO_L, then two coefficients of each harmonic [Wb]. `kept`: an element for each row, or
 * null. False: a number is not finite, or a covariance is not positive. */
bool fo_innovations(const fo_log *log, const fo_course *course, const double parameters[FO_UNKNOWNS],
                    const fo_start *start, fo_likelihood *out, fo_row *kept);

#ifdef __cplusplus
}
#endif
#endif
