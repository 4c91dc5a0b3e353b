/* Smooth a log and learn its assumptions: Gauss–Newton on the innovations of the smoother, the
 * prediction-error method with a prior (Ljung, doi:10.1109/TAC.1978.1101760). */
#ifndef FLUXOBS_LEARN_H
#define FLUXOBS_LEARN_H

#include "rows.h"

typedef struct {
    double p[FO_P];
    double covariance[FO_P * FO_P]; /* of the active assumptions, `columns` rows */
    double chi;          /* mean square of the normalised innovations */
    double correlation;  /* of neighbouring innovations */
    double cost;
    double filter_scale; /* factor on the smoother's covariance: the innovations are coloured */
    int iterations;
} fo_assumed;

typedef struct {
    fo_smooth_room room;
    size_t sides;
} fo_smoothed;

/* Starts from the reference of `w` and from `learnt->p`. `learning` false: the assumptions and
 * their covariance stay. Returns false: no memory. */
bool fo_learn(fo_work *w, bool learning, fo_assumed *learnt, fo_smoothed *smoothed);

/* Variance that the flux gains in a second [Wb^2/s] at a block. */
double fo_flux_walk(const fo_work *w, const double p[FO_P], size_t block);

#endif
