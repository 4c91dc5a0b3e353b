/* Smoothing: what all rows of a log say about the angle and the speed at each row. */
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

/* Smooths the rows that fo_innovations kept. `covariance` of the parameters, FO_UNKNOWNS squared, or
 * null: their share of the standard deviations. */
void fo_smooth(const fo_row *rows, size_t count, const double *covariance, fo_smoothed *out);

#ifdef __cplusplus
}
#endif
#endif
