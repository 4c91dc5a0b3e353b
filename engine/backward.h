/* The way back over the rows: what all innovations say about each row, and the score. */
#ifndef FLUXOBS_BACKWARD_H
#define FLUXOBS_BACKWARD_H

#include "innovations.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Angle and speed at the time of a row, with standard deviations. */
typedef struct {
    double angle, angle_std; /* [rad] */
    double speed, speed_std; /* [rad/s] */
} fo_smoothed;

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
} fo_outputs;

/* Completes the score of fo_innovations at the same parameters (`score`: FO_UNKNOWNS, or null).
 * `rows`: working space, FO_CHUNK elements. */
void fo_backward(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_filter *checkpoints, fo_row *rows, const fo_outputs *out, double *score);

#ifdef __cplusplus
}
#endif
#endif
