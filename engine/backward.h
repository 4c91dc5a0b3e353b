/* The way back over the rows: what all innovations say about each row, and the score. */
#ifndef FLUXOBS_BACKWARD_H
#define FLUXOBS_BACKWARD_H

#include "innovations.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The estimate of a row, with standard deviations; vectors in stator coordinates. */
#define FO_OF_A_ROW(NUMBER)                                                                     \
    NUMBER(angle)      /* [rad]                                                              */ \
    NUMBER(angle_std)                                                                           \
    NUMBER(speed)      /* [rad/s]                                                            */ \
    NUMBER(speed_std)                                                                           \
    NUMBER(flux_alpha) /* [Wb]                                                               */ \
    NUMBER(flux_beta)                                                                           \
    NUMBER(flux_alpha_std)                                                                      \
    NUMBER(flux_beta_std)                                                                       \
    NUMBER(psi)        /* of magnets or rotor [Wb]                                           */ \
    NUMBER(psi_std)                                                                             \
    NUMBER(drift_alpha) /* of the voltage [V]                                                */ \
    NUMBER(drift_beta)                                                                          \
    NUMBER(drift_alpha_std)                                                                     \
    NUMBER(drift_beta_std)                                                                      \
    NUMBER(torque)     /* over 3/2 of the pole pairs: flux × current [W s]                   */ \
    NUMBER(torque_std)                                                                          \
    NUMBER(innovation) /* its length over that of one standard deviation: 1 if the levels are right; 0: not measured */

typedef struct {
#define FO_ROW_NUMBER(name) double name;
    FO_OF_A_ROW(FO_ROW_NUMBER)
#undef FO_ROW_NUMBER
} fo_smoothed;

/* Shares of a variance: of each unknown but the levels, and of what remains if these are exact. Correlations
 * count for both unknowns by half. */
enum { FO_SHARES = FO_SENSITIVE + 1 };
/* Quantities that have them: angle, speed, a component of the flux, torque. */
enum { FO_SHARES_ANGLE, FO_SHARES_SPEED, FO_SHARES_FLUX, FO_SHARES_TORQUE, FO_QUANTITIES };
typedef double fo_shares[FO_QUANTITIES][FO_SHARES];

/* What all rows say about the errors at a row. Squares are expected ones, divided by the variance that the
 * filter assumes. */
typedef struct {
    double change; /* square of the change of the acceleration until the next row */
    double told;   /* share of that variance which the currents tell */
    double noise;  /* squares of both components of the current's noise; 2 if its level is right */
} fo_squares;

/* What is wanted of the rows; null: nothing. */
typedef struct {
    fo_course *course;   /* flux, angle and ψ: where to linearise next; may be that of the problem */
    fo_squares *squares;
    fo_smoothed *smoothed;
    const double *covariance; /* of the parameters, FO_UNKNOWNS squared: what it adds to `smoothed` */
    fo_shares *shares;        /* of every `stride`-th row, counted from `place` rows before the first one */
    size_t stride, place;
} fo_outputs;

/* The way back, after fo_innovations at the same parameters. The derivatives of the objective are added to `score`,
 * FO_UNKNOWNS numbers, unless it is null; with smoothed rows it must be. `rows`: working space, FO_CHUNK elements. */
void fo_backward(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_filter *checkpoints, fo_row *rows, const fo_outputs *out, double *score);

#ifdef __cplusplus
}
#endif
#endif
