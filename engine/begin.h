/* First values for learning, from angles that are nearly right. */
#ifndef FLUXOBS_BEGIN_H
#define FLUXOBS_BEGIN_H

#include "posterior.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Offset of the measured current: what does not turn with the rotor. */
void fo_begin_offset(const fo_log *log, const double *angle, const fo_prior *prior, double *parameters);

/* Std of a component of the current's noise [A], zero without noise. `spare`: a number for each row. */
double fo_first_noise(const fo_log *log, const double *angle, double *spare);

/* The course through angles, one for each row: its flux is that of the measured current. */
void fo_set_course(const fo_problem *problem, const double *angle, const double *parameters);

/* Level of the acceleration, and its unrest, from the course. */
void fo_begin_unrest(const fo_problem *problem, double *parameters);

#ifdef __cplusplus
}
#endif
#endif
