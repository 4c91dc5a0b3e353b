/* The posterior of the parameters of a log: likelihood of its currents, and priors. */
#ifndef FLUXOBS_POSTERIOR_H
#define FLUXOBS_POSTERIOR_H

#include "backward.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Priors, normal; a std of zero fixes a parameter at its mean. R, L_d, L_q, ψ and the lag have heavy
 * tails: a file is right within its tolerance, or it is that of another machine or log. */
typedef struct {
    double mean[FO_L], std[FO_L];
    double harmonics; /* scale of the harmonics' coefficients [Wb]; their level is estimated */
    bool round;       /* L_q is L_d */
    bool normal;      /* no heavy tails */
} fo_prior;

typedef struct {
    double parameters[FO_UNKNOWNS];
    double covariance[FO_UNKNOWNS * FO_UNKNOWNS];
    double harmonics;   /* level of the harmonics [Wb] */
    double objective;   /* −ln of likelihood and priors, without constant */
    double mean_square; /* of the normalised innovations */
    double conflict;    /* with the priors; see fo_conflict_of */
    size_t evaluations; /* of the likelihood */
    bool converged;     /* false: the bound on evaluations ended it */
} fo_posterior;

/* Half squares that the last step may gain. A parameter that is d standard deviations off costs d²/2, so no step is
 * longer than one of them. */
#define FO_FINE 0.5

/* Rows in which the unrest of the acceleration is constant. */
enum { FO_STRETCH = 25 };

/* Rows of a log that follow each other. */
typedef struct {
    size_t first, rows;
} fo_part;

/* A log, the parts on which it is learnt, and what learning works on: `checkpoints` of the chunks of the
 * log and one more for each part, `rows` of a chunk, `squares` of each row, the course `before` its last step
 * and the `best` one. */
typedef struct {
    fo_problem problem;
    const fo_part *parts;
    size_t count;
    fo_filter *checkpoints;
    fo_row *rows;
    fo_squares *squares;
    fo_course *before, *best;
    bool held; /* doubt and unrest stay as they are */
} fo_work;

/* Prior–data conflict: twice −ln of the priors, without constant, so that a parameter which is d standard deviations
 * off counts d², less if its tails are heavy. A level that is smaller than usual is no conflict. For a machine and a
 * drive that the priors describe, it has about the distribution χ² of the parameters that the log tells; a course that
 * is wrong makes parameters and errors that no drive has. */
double fo_conflict_of(const fo_prior *prior, const fo_posterior *at);

/* Learns from `out->parameters`, `out->harmonics` and the course: Gauss–Newton steps within a trust region, at most
 * `most` evaluations, until a step is expected to gain less than `gain` and the last gained little, or until some
 * steps have gained less; the best base counts. Each evaluation also gives the next course, the unrest of the
 * acceleration and the doubtful rows. False: the likelihood cannot be evaluated. */
bool fo_learn_parts(const fo_work *work, const fo_prior *prior, double gain, size_t most, fo_posterior *out);

/* Smooths the course at fixed parameters, so many times. A course that makes the objective larger is taken
 * back in part. */
bool fo_settle(const fo_work *work, const double *parameters, int passes);

/* Smooths the course at fixed parameters, so many times, and learns doubt, unrest and the level of the acceleration each
 * time. */
bool fo_settle_unrest(const fo_work *work, const fo_prior *prior, int passes, double parameters[FO_UNKNOWNS]);

/* Covariance of the parameters, from the information of the course. False: the likelihood cannot be evaluated. */
bool fo_course_covariance(const fo_work *work, const fo_prior *prior, fo_posterior *out);

/* Estimates of a log: an element for each row, and shares of the variances of every `stride`-th one, or null. */
typedef struct {
    fo_smoothed *rows;
    fo_shares *shares;
    size_t stride;
} fo_estimates;

/* Covariance of the parameters, and the rows of the parts. False: the likelihood cannot be evaluated. */
bool fo_smooth_parts(const fo_work *work, const fo_prior *prior, fo_posterior *out, const fo_estimates *estimates);

/* Covariance at the likelihood. False: the curvature is not positive. */
bool fo_covariance(const fo_likelihood *at, const fo_prior *prior, fo_posterior *out);

#ifdef __cplusplus
}
#endif
#endif
