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

#include "relation.h"

#ifdef __cplusplus
extern "C" {
#endif

/* States; vectors in stator coordinates. The noise is the predictable part of coloured noise; it is
 * the last, so that white noise needs FO_WHITE states only. */
enum {
    FO_FLUX,
    FO_ANGLE = 2,
    FO_SPEED, /* of the rotor; a cage's flux turns faster by the slip */
    FO_PSI,   /* flux of magnets or rotor, less the parameter */
    FO_ACCELERATION,
    FO_DRIFT,
    FO_NOISE = 8,
    FO_WHITE = FO_NOISE,
    FO_STATES = 10
};
/* Those of the course and of the result: flux, angle, speed, ψ. */
enum { FO_OWN = 5 };
/* Elements of the transition that may not be zero; see innovations.c. */
enum { FO_ELEMENTS = 43 };

/* A log. */
typedef struct {
    size_t rows;
    double sample_time;    /* [s] */
    /* rows × 2, NaN where they are missing: mean from this row to the next, with the log's lag [V] */
    const double *voltage;
    const double *current; /* [A] */
} fo_log;

/* What is known before the first row: standard deviations about the course. */
typedef struct {
    double flux_std, angle_std; /* [Wb], [rad] */
    double speed_std;           /* [rad/s] */
    double psi_std;             /* [Wb] */
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
    double by_flux[4];               /* derivatives of the current: αα, αβ, βα, ββ */
    double by_angle[2], by_psi[2];
    double F[FO_ELEMENTS];           /* transition to the next row */
    double error_by[2][FO_UNKNOWNS]; /* derivatives of the innovation by the parameters */
    double own_by[2][FO_UNKNOWNS];   /* derivatives of angle and speed */
    bool measured;
} fo_row;

/* Rows and columns of the elements of the transition. */
extern const unsigned char fo_pattern[FO_ELEMENTS][2];

/* `parameters`: FO_L, then two coefficients of each harmonic [Wb]. `kept`: an element for each row, or
 * null. False: a number is not finite, or a covariance is not positive. */
bool fo_innovations(const fo_log *log, const fo_machine *machine, const fo_course *course,
                    const double parameters[FO_UNKNOWNS], const fo_start *start,
                    fo_likelihood *out, fo_row *kept);

#ifdef __cplusplus
}
#endif
#endif
