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
    double cost;         /* less that of the noise; a block left out costs as one that just fits */
    double noise;        /* what the noise of the currents would cost */
    double filter_scale; /* factor on the smoother's covariance: the innovations are coloured */
    bool settled;  /* the steps of learning became small */
    bool left_out; /* blocks did not fit and were left out */
} fo_assumed;

typedef struct {
    fo_smooth_room room;
    size_t sides;
} fo_smoothed;

/* Starts from the reference of `w` and from `learnt->p`. `learning` false: the assumptions and
 * their covariance stay. Returns false: no memory, or stopped. */
bool fo_learn(fo_work *w, bool learning, fo_assumed *learnt, fo_smoothed *smoothed);

/* Mean square of the normalised innovations around each block, within FO_MISFIT_TIME. */
void fo_misfits(const fo_work *w, const fo_smoothed *s, double *misfit);

/* A row is known if the innovations around it have less than this mean square; 1 would be what the
 * model expects of a poor drive, and usual are 0.001 to 0.05. */
#define FO_KNOWN_MISFIT 0.3
/* Time around a row over which the innovations are averaged [s]. */
#define FO_MISFIT_TIME 0.02

/* Variance that the flux gains in a second [Wb^2/s] at a block. */
double fo_flux_walk(const fo_work *w, const double p[FO_P], size_t block);

#endif
