/* The direction from an injected current.
 *
 * An error e of the angle leaves the residual -j e a of the relation, in rotor coordinates. If the
 * current changes by d, the residual changes by -j e M d, with
 *
 *     a(i) = F(i) + j J (j i),  M d = J d + j J (j d),
 *
 * whatever the flux. M is symmetric without trace, and zero without saliency. A change of the current
 * in any direction so shows the angle. d comes from the volt-seconds, d = J⁻¹ Δλ: with the measured
 * change, the same noise would be in M d and in the residual. M is that of the machine as given: near
 * the right angle the log hardly determines M, and a learnt M can come out as zero. */
#ifndef FLUXOBS_DIRECTION_H
#define FLUXOBS_DIRECTION_H

#include "model.h"

/* A row in rotor coordinates. */
typedef struct {
    vec rest, flux, auxiliary; /* residual, flux, and a [Wb] */
    double angle;              /* [rad] */
} fo_ripple_row;

/* Sums over the changes from row to row. */
typedef struct {
    fo_ripple_row last;
    bool seen;
    vec response;           /* last M d as given */
    double rows, product, square, lagged;
    double saliency, square_d, square_q; /* squares of M, of L_d and of L_q [H^2] */
    double noise, noise_d, noise_q; /* squares of the noise in `product`; of it from L_d, L_q */
    double size;            /* of a */
} fo_ripple;

/* Adds a row; returns whether it added a change. `given`: the relation of the machine as given.
 * `rotation`: of the rotor within a sample [rad]. */
bool fo_add_ripple(fo_ripple *s, const fo_ripple_row *now, const fo_relation *f,
                   const fo_relation *given, bool measured, double rotation);

/* Whether the changes show the direction. */
bool fo_shows_direction(const fo_model *m, const fo_ripple *s);

/* Error of the angle [rad], and its variance from the noise of the current [rad^2]. */
double fo_direction_error(const fo_ripple *s);
double fo_direction_variance(const fo_model *m, const fo_ripple *s);

/* Relative variance of M from the priors of both inductances: it may be smaller than given. */
double fo_saliency_variance(const fo_model *m, const fo_ripple *s);

/* Starts the next sums. */
void fo_next_ripple(fo_ripple *s);

#endif
