/* Fixed-interval smoother of a log's slow errors, for many right-hand sides at once.
 *
 * Between two blocks of samples the flux changes by the volt-seconds, which are known, and by a
 * correction c, which is not: c integrates a drift θ and a white voltage error. The state is
 *
 *     (c_α, c_β [Wb], θ_α, θ_β [V], ψ [Wb], R [Ω]),
 *
 * with the deviations ψ and R of magnet flux and resistance from their assumed values. A block has
 * one or two measurements, each linear in the state. All right-hand sides have the same covariances and
 * gains: the first is the measurement, the others are its derivatives by parameters. The smoothed
 * right-hand sides are then the state and its sensitivities (Friedland, doi:10.1109/TAC.1969.1099223).
 *
 * Forwards: Kalman filter. Backwards: the adjoint recursion of Bryson and Frazier in Bierman's
 * modified form, which needs no inverse (doi:10.1080/00207177308932487).
 */
#ifndef FLUXOBS_SMOOTHER_H
#define FLUXOBS_SMOOTHER_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* States, and measurements of a block at most. */
enum { FO_SMOOTH = 6, FO_MEASUREMENTS = 2 };

typedef struct {
    double duration;    /* since the previous block [s] */
    double coupling[2]; /* change of c per unit of R: -∫ i dt since the previous block [A s] */
    double decay;       /* factor on ψ since the previous block */
    double walk[4];     /* variance gained since then: by a component of c, of θ, by ψ, by R */
    double floating[3]; /* variance gained by c besides, αα, αβ, ββ: a phase without a known voltage */
    double row[FO_MEASUREMENTS][FO_SMOOTH];
    double variance[FO_MEASUREMENTS]; /* infinite: there is no such measurement */
} fo_smooth_block;

/* Room that the caller provides; in numbers. */
typedef struct {
    double *state;      /* blocks * FO_SMOOTH * sides: result, smoothed */
    double *covariance; /* blocks * FO_SMOOTH * FO_SMOOTH: result, smoothed */
    double *innovation; /* blocks * measurements * sides: result, 0 without measurement */
    double *spread;     /* blocks * measurements: result, variance of the innovations; infinite
                         * without */
    double *gain;       /* blocks * measurements * FO_SMOOTH */
    double *work;       /* 2 * FO_SMOOTH * sides */
} fo_smooth_room;

/* `measured`: blocks * measurements * sides. `start`: variance of each state before the first block,
 * whose mean is zero for every right-hand side. Errors of the measurements are independent. */
void fo_smooth(const fo_smooth_block *block, size_t blocks, size_t measurements,
               const double *measured, size_t sides, const double start[FO_SMOOTH],
               const fo_smooth_room *room);

/* Variance of each innovation that comes from white noise of the measurements with these variances,
 * through the filter with the gains of `room`; 0 without measurement. */
void fo_smooth_noise(const fo_smooth_block *block, size_t blocks, size_t measurements,
                     const fo_smooth_room *room, const double *noise, double *through);

#ifdef __cplusplus
}
#endif
#endif
