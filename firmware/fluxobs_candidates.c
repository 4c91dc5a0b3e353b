/* SPDX-License-Identifier: MIT */
#include "fluxobs_candidates.h"

#include "fluxobs_internal.h"

#include <string.h>

/* Elements on the manifold; the last is the square of the magnet flux. */
enum { M_FLUX = 0, M_DRIFT = FO_N, M_SQUARE = 2 * FO_N };

/* ---- thresholds: unit, reason, and what determined their value ----------------------------
 * "Benchmark" is the start in benchmarks/adaptive.py: the worst of 40 unknown angles, 90 degrees
 * after the start. "Tests" are in tests/observers/test_adaptive. */

/* Damping of the Gauss-Newton steps, as information [1, that of one sample]. A thousandth keeps the
 * matrix regular before the first sample and is negligible afterwards (tests). */
static const fo_real DAMPING = (fo_real)1e-3;
/* Square of the cosine of the angle below which candidates are the same [1]: 22.5 degrees, half of
 * the range that each of the four candidates covers to a side (benchmark). */
static const fo_real SAME_DIRECTION = (fo_real)0.8536;
/* Steps after which a candidate has converged [1]. Each Gauss-Newton step doubles the digits: four
 * steps reduce 22.5 degrees to less than noise (benchmark). */
static const uint32_t CONVERGED_AFTER = 4U;
/* Candidates that must converge to the best candidate [1]: one and a half rounds of the four, so
 * that no hypothesis between them is missed (benchmark). */
static const uint32_t CONFIRMATIONS = 6U;
/* Largest weight that another candidate may have at the start [1]. The weight is the probability of
 * a wrong start (benchmark). */
static const fo_real SECOND_WEIGHT_MAX = (fo_real)0.01;
/* Share of noise that the information may have at the start [1]. It is three times that of a valid
 * position, because the filter checks itself later (benchmark, noise 2.5 %). */
static const fo_real START_SHARE = (fo_real)0.3;
/* Upper bound of the noise share [1]: the remaining share is a divisor. */
static const fo_real NOISE_SHARE_MAX = (fo_real)0.99;
/* Differences of two costs below this many stds of noise are ignored [1]: noise exceeds the limit
 * once in 30 000 starts (benchmark). */
static const fo_real FLUCTUATION = (fo_real)4;
/* Parameter-to-EMF ratio up to which the start does not wait for the plain observer's position [1]:
 * a ratio of a fifth turns the flux by 11 degrees (benchmark). */
static const fo_real QUICK_START = (fo_real)0.2;
/* Upper bound of the parameter-to-EMF ratio [1]: above a half the EMF determines no angle. */
static const fo_real EMF_RATIO_MAX = (fo_real)0.5;
/* Smallest square of a magnet flux [flux bases]: the flux is a fifth of the assumed one. A shorter
 * vector has no direction (tests). */
static const fo_real SQUARE_MIN = (fo_real)0.04;
/* Smallest square of a position vector that has a direction [flux bases]: its length is a hundredth
 * (tests). */
static const fo_real LENGTH_SQUARE_MIN = (fo_real)1e-4;

/* Position vector of a candidate. */
static void candidate_position(const fo_adaptive *a, const fo_adaptive_state *s,
                               const fo_candidate *c, fo_real x[FO_N]) {
    for (int i = 0; i < FO_N; i++) {
        x[i] = c->p[M_FLUX + i] - armature_flux(&a->plain, &s->plain, i);
    }
}

/* Present estimate of the magnet flux; 0 without magnets. */
static fo_real magnet_flux(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return a->psi > ZERO ? a->psi + a->std[FO_PSI] * s->p[FO_PSI] : ZERO;
}

/* Do two position vectors have the same direction within SAME_DIRECTION? */
static bool same_direction(const fo_real x[FO_N], const fo_real y[FO_N])
{
    const fo_real product = dot(x, y);
    return product > ZERO && product * product > SAME_DIRECTION * dot(x, x) * dot(y, y);
}

/* Places a candidate in the direction of x. */
static void place_candidate(const fo_adaptive *a, const fo_adaptive_state *s, const fo_real x[FO_N],
                fo_candidate *c)
{
    const fo_real psi = magnet_flux(a, s);
    const fo_real length = fo_sqrt(dot(x, x)), distance = psi > ZERO ? psi : ONE;
    (void)memset(c, 0, sizeof *c);
    for (int i = 0; i < FO_N; i++) {
        const fo_real along = length > ZERO ? x[i] / length : i == 0 ? ONE : ZERO;
        c->p[M_FLUX + i] = distance * along + armature_flux(&a->plain, &s->plain, i);
    }
    c->p[M_SQUARE] = psi * psi;
    c->theta = fo_atan2(x[1], x[0]);
    c->variance = VARIANCE_UNKNOWN;
}

void fo_candidates_place(const fo_adaptive *a, fo_adaptive_state *s)
{
    fo_real x[FO_N] = {s->x[0], s->x[1]};
    if (s->plain.trusted) {
        for (int i = 0; i < FO_N; i++) {
            x[i] = s->plain.x[FLUX + i] - armature_flux(&a->plain, &s->plain, i);
        }
    }
    for (int k = 0; k < FO_CANDIDATES; k++) { /* a quarter of a turn apart */
        const fo_real before = x[0];
        place_candidate(a, s, x, &s->now.start.candidates[k]);
        x[0] = -x[1];
        x[1] = before;
    }
    s->running = false;
    s->now.start.confirmations = 0U;
    s->now.start.best = 0;
}

/* Parameter-to-EMF ratio, bounded. */
static fo_real limited_emf_ratio(const fo_adaptive_state *s)
{
    return s->emf_ratio < EMF_RATIO_MAX ? s->emf_ratio : EMF_RATIO_MAX;
}

/* Sets the information to damping and the prior of the magnet flux. Through the parameter-to-EMF
 * ratio, the prior's variance includes the variance of resistance and inverter. */
static void set_prior(const fo_adaptive *a, const fo_adaptive_state *s, const fo_candidate *c,
                  fo_manifold *m)
{
    const fo_real psi = magnet_flux(a, s), square = psi * psi, ratio = limited_emf_ratio(s);
    const fo_real variance =
        (fo_real)4 * square * (a->std[FO_PSI] * a->std[FO_PSI] + ratio * ratio * square);
    (void)memset(m, 0, sizeof *m);
    for (int i = 0; i < FO_NM; i++) {
        m->d[i] = DAMPING;
    }
    m->d[M_SQUARE] = ONE / (variance + (fo_real)1e-6);
    m->z[M_SQUARE] = square - c->p[M_SQUARE];
}

void fo_gauss_newton_step(const fo_adaptive *a, const fo_adaptive_state *s, fo_candidate *c,
                          fo_manifold *m) {
    const fo_information *info = &s->plain.info;
    fo_real x_before[FO_N];
    candidate_position(a, s, c, x_before);
    const fo_real *flux = &c->p[M_FLUX], *drift = &c->p[M_DRIFT], *u = info->U;
    fo_real row_x[FO_NX], immersed[FO_NX], x[FO_N], row[FO_NM], predicted = ZERO;

    /* The immersion's state as a function of the manifold's: docs/theory.md, section 13. */
    immersed[S] = dot(flux, flux) - c->p[M_SQUARE];
    immersed[KAPPA] = TWO * dot(flux, drift);
    immersed[CC] = dot(drift, drift);
    for (int i = 0; i < FO_N; i++) {
        immersed[FLUX + i] = flux[i];
        immersed[DRIFT + i] = drift[i];
    }
    set_prior(a, s, c, m);
    fo_real cost = m->d[M_SQUARE] * m->z[M_SQUARE] * m->z[M_SQUARE];
    (void)memset(row_x, 0, sizeof row_x);
    for (int j = 0; j < FO_NX; j++) { /* U_j (x - x(p)), and its gradient by p */
        fo_real residual = info->z[j] - immersed[j];
        if (j > 0) {
            row_x[j - 1] = ZERO;
        }
        row_x[j] = ONE;
        for (int k = j + 1; k < FO_NX; k++) {
            row_x[k] = *u;
            residual -= *u * immersed[k];
            u++;
        }
        for (int i = 0; i < FO_N; i++) {
            row[M_FLUX + i] =
                row_x[FLUX + i] + TWO * (row_x[S] * flux[i] + row_x[KAPPA] * drift[i]);
            row[M_DRIFT + i] =
                row_x[DRIFT + i] + TWO * (row_x[KAPPA] * flux[i] + row_x[CC] * drift[i]);
        }
        row[M_SQUARE] = -row_x[S];
        cost += info->d[j] * residual * residual;
        fo_real value = residual, weight = info->d[j];
        fo_add_row_to(FO_NM, m->U, m->d, m->z, 0, FO_NM, row, &value, &weight);
        predicted += weight * value * value;
    }
    /* Current noise in the rows adds noise psi^2 to the cost, which pulls psi to zero: subtract
     * this term. The term is linear in the last unknown, and so changes nothing else in the factor.
     * If the data contain no information on that unknown, nothing changes. */
    const fo_real noise = info->noise[0], information = m->d[M_SQUARE];
    const fo_real shift = information > ZERO ? noise / (TWO * information) : ZERO;
    predicted -= information * shift * shift;
    m->z[M_SQUARE] += shift;
    c->cost = cost - noise * c->p[M_SQUARE];

    fo_real step[FO_NM];
    fo_solve(FO_NM, m->U, m->z, 0, FO_NM, step);
    for (int i = 0; i < FO_NM; i++) {
        c->p[i] += step[i];
    }
    const fo_real lowest = a->psi > ZERO ? SQUARE_MIN : ZERO;
    c->p[M_SQUARE] = c->p[M_SQUARE] > lowest ? c->p[M_SQUARE] : lowest;
    c->predicted_cost = predicted - noise * c->p[M_SQUARE];
    candidate_position(a, s, c, x);
    /* after a jump the candidate must converge again */
    c->age = same_direction(x, x_before) ? c->age + 1U : 0U;
    const fo_real square = dot(x, x),
                  all = dot(drift, drift) + c->p[M_SQUARE] + c->cost + c->predicted_cost;
    if (square > LENGTH_SQUARE_MIN && square < RUNAWAY && all - all == ZERO) {
        fo_real y[FO_NM] = {-x[1], x[0], ZERO, ZERO, ZERO};
        c->theta = fo_atan2(x[1], x[0]);
        c->variance = fo_marginal_variance(FO_NM, m->U, m->d, 0, FO_NM, y);
        c->variance /= square * square;
        c->variance = c->variance < VARIANCE_UNKNOWN ? c->variance : VARIANCE_UNKNOWN;
    } else { /* diverged, or NaN */
        const fo_real across[FO_N] = {-s->x[1], s->x[0]};
        place_candidate(a, s, across, c);
    }
}

/* Index of the converged candidate with the smallest cost, or -1. */
static int best_candidate(const fo_adaptive_state *s)
{
    int best = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &s->now.start.candidates[k];
        if (c->age >= CONVERGED_AFTER &&
            (best < 0 || c->cost < s->now.start.candidates[best].cost)) {
            best = k;
        }
    }
    return best;
}

/* Index of the next best converged candidate in another direction, or -1. Candidates in the same
 * direction as the best are placed elsewhere. */
static int second_candidate(const fo_adaptive *a, fo_adaptive_state *s, int best)
{
    int second = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &s->now.start.candidates[k];
        if (k != best && c->age >= CONVERGED_AFTER) {
            fo_real x[FO_N], y[FO_N];
            candidate_position(a, s, &s->now.start.candidates[best], x);
            candidate_position(a, s, c, y);
            if (same_direction(x, y)) {
                for (uint32_t quarters = 1U + s->now.start.confirmations % 3U; quarters > 0U;
                     quarters--) {
                    const fo_real before = x[0];
                    x[0] = -x[1];
                    x[1] = before;
                }
                place_candidate(a, s, x, &s->now.start.candidates[k]);
                s->now.start.confirmations++;
            } else if (second < 0 ||
                       c->predicted_cost < s->now.start.candidates[second].predicted_cost) {
                second = k;
            } else {
                /* this candidate is worse than the second */
            }
        }
    }
    return second;
}

/* Approximately exp(-x), x >= 0. */
static fo_real exp_of_minus(fo_real x)
{
    const fo_real third = ONE + x / (fo_real)3 * (ONE + x / (fo_real)4);
    return ONE / (ONE + x * (ONE + x / TWO * third));
}

/* Likelihood ratio of the second candidate to the best. The best candidate's position vector has
 * this square. */
static fo_real likelihood_ratio(const fo_adaptive *a, const fo_adaptive_state *s,
                                const fo_candidate *best, const fo_candidate *second,
                                fo_real square, fo_real inflation) {
    const fo_real noise = TWO * a->plain.noise_information * s->plain.info.noise[0];
    const fo_real chance = FLUCTUATION * fo_sqrt(noise) * square;
    const fo_real x = (second->predicted_cost - best->cost - chance) / (TWO * inflation);
    return exp_of_minus(x > ZERO ? x : ZERO);
}

void fo_candidates_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real v[FO_N],
                        fo_choice *choice)
{
    const uint32_t round = s->sample_index % (uint32_t)FO_CANDIDATES;
    const int stepped = (int)round;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        fo_real *p = s->now.start.candidates[k].p;
        for (int i = 0; i < FO_N; i++) {
            p[M_FLUX + i] += v[i] + a->plain.h * p[M_DRIFT + i];
        }
    }
    fo_gauss_newton_step(a, s, &s->now.start.candidates[stepped], &choice->information);

    const int best = best_candidate(s);
    choice->has_best = best >= 0;
    choice->decided = false;
    choice->second_weight = ONE / TWO;
    if (choice->has_best) {
        fo_candidate *c = &s->now.start.candidates[best];
        const fo_real power = s->plain.power;
        const fo_real inflation = power > ONE ? power : ONE;
        fo_real x[FO_N], other = ZERO;
        candidate_position(a, s, c, x);
        if (s->now.start.best != best) {
            fo_real before[FO_N];
            candidate_position(a, s, &s->now.start.candidates[s->now.start.best], before);
            if (!same_direction(x, before) ||
                s->now.start.candidates[s->now.start.best].age < CONVERGED_AFTER) {
                s->now.start.confirmations = 0U;
                s->tracker.settled = ZERO;
            }
            s->now.start.best = best;
        }
        const fo_real square = dot(x, x);
        const int second = second_candidate(a, s, best);
        choice->second_theta = c->theta;
        if (second >= 0) {
            choice->second_theta = s->now.start.candidates[second].theta;
            other = likelihood_ratio(a, s, c, &s->now.start.candidates[second], square, inflation);
            s->now.start.confirmations =
                other > SECOND_WEIGHT_MAX ? 0U : s->now.start.confirmations;
        }
        choice->best = *c;
        choice->best.theta = fo_atan2(x[1], x[0]);
        track(&a->plain, &s->tracker, choice->best.theta);
        settle_tracker(&a->plain, &s->tracker, choice->best.theta, fo_sqrt(c->variance));
        const bool quick = !(s->emf_ratio > ZERO) ||
                           (s->emf_ratio < QUICK_START && s->tracker.settled >= TRACKER_SETTLED);
        const fo_real share = s->plain.info.noise[0] * c->variance * square;
        choice->inflation =
            inflation / (share < NOISE_SHARE_MAX ? ONE - share : ONE - NOISE_SHARE_MAX);
        choice->best.variance *= choice->inflation;
        choice->second_weight =
            s->now.start.confirmations >= CONFIRMATIONS ? other / (ONE + other) : ONE / TWO;
        choice->decided = stepped == best && (quick || s->plain.trusted) &&
                          s->now.start.confirmations >= CONFIRMATIONS &&
                          other < SECOND_WEIGHT_MAX && share < START_SHARE &&
                          choice->best.variance < START_STD * START_STD;
    }
}
