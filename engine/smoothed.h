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

/* For each row: expected square of the change of the acceleration until the next row, over its
 * variance in the filter, `variance` times the unrest of the course. */
void fo_smooth_changes(const fo_row *rows, size_t count, double variance, const fo_course *course,
                       double *out);

/* Angle and speed at the time of the row, with standard deviations. `parameters` and their
 * `covariance`, FO_UNKNOWNS squared: what they add. */
void fo_smooth(const fo_row *rows, size_t count, double sample_time, const double *parameters,
               const double *covariance, fo_smoothed *out);

#ifdef __cplusplus
}
#endif
#endif
