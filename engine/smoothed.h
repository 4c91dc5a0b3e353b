/* Smoothing: what all rows of a log say about flux, angle and speed at each row. */
#ifndef FLUXOBS_SMOOTHED_H
#define FLUXOBS_SMOOTHED_H

#include "innovations.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double angle, angle_std; /* [rad] */
    double speed, speed_std; /* [rad/s] */
} fo_smoothed;

/* The course of the rows that fo_innovations kept: where to linearise next. */
void fo_smooth_course(const fo_row *rows, size_t count, fo_course *out);

/* Expected squares at a row, over their variances in the filter. */
typedef struct {
    double change; /* of the acceleration until the next row */
    double noise;  /* of both components of the current's noise; 2 if its level is right */
} fo_squares;

/* For each row. `acceleration` and `noise`: variances, which the course's unrest and doubt multiply. */
void fo_smooth_squares(const fo_row *rows, size_t count, double acceleration, double noise,
                       const fo_course *course, fo_squares *out);

/* Angle and speed at the time of the row, with standard deviations. `parameters` and their
 * `covariance`, FO_UNKNOWNS squared: what they add. */
void fo_smooth(const fo_row *rows, size_t count, double sample_time, const double *parameters,
               const double *covariance, fo_smoothed *out);

#ifdef __cplusplus
}
#endif
#endif
