/* First reference of a log's flux: extended Kalman filters in both directions, anchored where an
 * observer knows the angle, joined by their information. */
#ifndef FLUXOBS_START_H
#define FLUXOBS_START_H

#include "rows.h"

/* Sets correction, angle and speed of `w`. False: no memory. */
bool fo_start(fo_work *w, const double p[FO_P]);

/* Least variance of a block's residual: the model's error decorrelates as the rotor turns. */
double fo_model_variance(const fo_model *m, double rotation);

#endif
