/* The posterior of the parameters of a log: likelihood of its currents, and priors. */
#ifndef FLUXOBS_POSTERIOR_H
#define FLUXOBS_POSTERIOR_H

#include "innovations.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Priors, normal; a std of zero fixes a parameter at its mean. R, L_d, L_q and ψ have heavy tails: a
 * machine file is right within its tolerance, or it is that of another machine. */
typedef struct {
    double mean[FO_L], std[FO_L];
    double harmonics; /* scale of the harmonics' coefficients [Wb]; their level is estimated */
    bool round;       /* L_q is L_d */
} fo_prior;

typedef struct {
    double parameters[FO_UNKNOWNS];
    double covariance[FO_UNKNOWNS * FO_UNKNOWNS];
    double harmonics;   /* level of the harmonics [Wb] */
    double objective;   /* −ln of likelihood and prior, without constant */
    double mean_square; /* of the normalised innovations */
    size_t evaluations; /* of the likelihood */
    bool converged;     /* false: the bound on evaluations ended it */
} fo_posterior;

/* Levenberg–Marquardt from `out->parameters` and `out->harmonics`, at most `most` evaluations, until a
 * step gains less than `gain`. `free`: which of the FO_L may move; null: all with a std. False: the
 * likelihood cannot be evaluated at the first parameters. */
bool fo_maximise(const fo_log *log, const fo_start *start, const fo_prior *prior, const bool *free,
                 double gain, size_t most, fo_posterior *out);

/* Covariance at the likelihood, with the first angle as an unknown of which nothing is known. False:
 * the curvature is not positive. */
bool fo_covariance(const fo_likelihood *at, const fo_prior *prior, fo_posterior *out);

#ifdef __cplusplus
}
#endif
#endif
