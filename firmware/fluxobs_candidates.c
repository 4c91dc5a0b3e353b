/* SPDX-License-Identifier: MIT */
#include "fluxobs_candidates.h"

#include "fluxobs_internal.h"
#include "fluxobs_learning.h"

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
/* Largest std of the angle of the plain observer's solution from which the filter starts [rad]. */
static const fo_real START_STD_FROM_PLAIN = PI / (fo_real)6;
/* Smallest square of a magnet flux [flux bases]: the flux is a fifth of the assumed one. A shorter
 * vector has no direction (tests). */
static const fo_real SQUARE_MIN = (fo_real)0.04;
/* Smallest square of a position vector that has a direction [flux bases]: its length is a hundredth
 * (tests). */
static const fo_real LENGTH_SQUARE_MIN = (fo_real)1e-4;

/* Position vector of a candidate. */
static void candidate_position(const fo_mail *m, const fo_candidate *c, fo_real x[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        x[i] = c->p[M_FLUX + i] - m->data.search.armature_flux[i];
    }
}

/* Present estimate of the magnet flux; 0 without magnets. */
static fo_real magnet_flux(const fo_adaptive *a, const fo_learner *s)
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
static void place_candidate(const fo_adaptive *a, const fo_learner *s, const fo_mail *m,
                            const fo_real x[FO_N], fo_candidate *c)
{
    const fo_real psi = magnet_flux(a, s);
    const fo_real length = fo_sqrt(dot(x, x)), distance = psi > ZERO ? psi : ONE;
    (void)memset(c, 0, sizeof *c);
    for (int i = 0; i < FO_N; i++) {
        const fo_real along = length > ZERO ? x[i] / length : i == 0 ? ONE : ZERO;
        c->p[M_FLUX + i] = distance * along + m->data.search.armature_flux[i];
    }
    c->p[M_SQUARE] = psi * psi;
    c->theta = fo_atan2(x[1], x[0]);
    c->variance = VARIANCE_UNKNOWN;
}

/* Places candidates a quarter of a turn apart. The first candidate is at the last known
 * position. */
static void place_candidates(const fo_adaptive *a, const fo_learner *s, const fo_mail *m,
                             fo_search *search)
{
    const fo_search_data *data = &m->data.search;
    fo_real x[FO_N] = {data->direction[0], data->direction[1]};
    if (data->trusted) {
        for (int i = 0; i < FO_N; i++) {
            x[i] = data->flux[i] - data->armature_flux[i];
        }
    }
    for (int k = 0; k < FO_CANDIDATES; k++) { /* a quarter of a turn apart */
        const fo_real before = x[0];
        place_candidate(a, s, m, x, &search->candidates[k]);
        x[0] = -x[1];
        x[1] = before;
    }
    search->next = 0U;
    search->confirmations = 0U;
    search->best = 0;
}

/* Parameter-to-EMF ratio, bounded. */
static fo_real limited_emf_ratio(const fo_mail *m)
{
    return m->end.emf_ratio < EMF_RATIO_MAX ? m->end.emf_ratio : EMF_RATIO_MAX;
}

/* Sets the information to damping and the prior of the magnet flux. Through the parameter-to-EMF
 * ratio, the prior's variance includes the variance of resistance and inverter. */
static void set_prior(const fo_adaptive *a, const fo_learner *s, const fo_mail *mail,
                      const fo_candidate *c, fo_manifold *m)
{
    const fo_real psi = magnet_flux(a, s), square = psi * psi, ratio = limited_emf_ratio(mail);
    const fo_real variance =
        (fo_real)4 * square * (a->std[FO_PSI] * a->std[FO_PSI] + ratio * ratio * square);
    (void)memset(m, 0, sizeof *m);
    for (int i = 0; i < FO_NM; i++) {
        m->d[i] = DAMPING;
    }
    m->d[M_SQUARE] = ONE / (variance + (fo_real)1e-6);
    m->z[M_SQUARE] = square - c->p[M_SQUARE];
}

void fo_gauss_newton_step(const fo_adaptive *a, const fo_learner *s, const fo_mail *mail,
                          fo_candidate *c, fo_manifold *m)
{
    const fo_information *info = &mail->data.search.info;
    fo_real x_before[FO_N];
    candidate_position(mail, c, x_before);
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
    set_prior(a, s, mail, c, m);
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
    candidate_position(mail, c, x);
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
        const fo_real *along = mail->data.search.direction;
        const fo_real across[FO_N] = {-along[1], along[0]};
        place_candidate(a, s, mail, across, c);
    }
}

/* Index of the converged candidate with the smallest cost, or -1. */
static int best_candidate(const fo_search *search)
{
    int best = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &search->candidates[k];
        if (c->age >= CONVERGED_AFTER &&
            (best < 0 || c->cost < search->candidates[best].cost)) {
            best = k;
        }
    }
    return best;
}

/* Index of the next best converged candidate in another direction, or -1. Candidates in the same
 * direction as the best are placed elsewhere. */
static int second_candidate(const fo_adaptive *a, const fo_learner *s, const fo_mail *m,
                            fo_search *search, int best)
{
    int second = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &search->candidates[k];
        if (k != best && c->age >= CONVERGED_AFTER) {
            fo_real x[FO_N], y[FO_N];
            candidate_position(m, &search->candidates[best], x);
            candidate_position(m, c, y);
            if (same_direction(x, y)) {
                for (uint32_t quarters = 1U + search->confirmations % 3U; quarters > 0U;
                     quarters--) {
                    const fo_real before = x[0];
                    x[0] = -x[1];
                    x[1] = before;
                }
                place_candidate(a, s, m, x, &search->candidates[k]);
                search->confirmations++;
            } else if (second < 0 ||
                       c->predicted_cost < search->candidates[second].predicted_cost) {
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
static fo_real likelihood_ratio(const fo_adaptive *a, const fo_mail *m,
                                const fo_candidate *best, const fo_candidate *second,
                                fo_real square, fo_real inflation) {
    const fo_real noise = TWO * a->plain.noise_information * m->data.search.info.noise[0];
    const fo_real chance = FLUCTUATION * fo_sqrt(noise) * square;
    const fo_real x = (second->predicted_cost - best->cost - chance) / (TWO * inflation);
    return exp_of_minus(x > ZERO ? x : ZERO);
}

/* The best candidate after a step. */
typedef struct {
    fo_candidate best;
    bool has_best;          /* false: no candidate has converged   */
    bool decided;           /* the filter may start from the best  */
    fo_real inflation;      /* inflation of its covariance         */
    fo_real second_theta, second_weight; /* second best: angle [rad], weight 0 to 1/2 */
} choice;

/* Compares the candidates after the step of candidate `stepped`. */
static void choose(const fo_adaptive *a, const fo_learner *s, const fo_mail *m, fo_search *search,
                   int stepped, choice *c, bool *other_direction)
{
    const fo_search_data *data = &m->data.search;
    const int best = best_candidate(search);
    c->has_best = best >= 0;
    c->decided = false;
    c->second_weight = ONE / TWO;
    if (c->has_best) {
        fo_candidate *first = &search->candidates[best];
        const fo_real inflation = data->power > ONE ? data->power : ONE;
        fo_real x[FO_N], other = ZERO;
        candidate_position(m, first, x);
        if (search->best != best) {
            fo_real before[FO_N];
            candidate_position(m, &search->candidates[search->best], before);
            if (!same_direction(x, before) ||
                search->candidates[search->best].age < CONVERGED_AFTER) {
                search->confirmations = 0U;
                *other_direction = true;
            }
            search->best = best;
        }
        const fo_real square = dot(x, x);
        const int second = second_candidate(a, s, m, search, best);
        c->second_theta = first->theta;
        if (second >= 0) {
            c->second_theta = search->candidates[second].theta;
            other = likelihood_ratio(a, m, first, &search->candidates[second], square, inflation);
            search->confirmations = other > SECOND_WEIGHT_MAX ? 0U : search->confirmations;
        }
        c->best = *first;
        c->best.theta = fo_atan2(x[1], x[0]);
        const bool quick = !(m->end.emf_ratio > ZERO) ||
                           (m->end.emf_ratio < QUICK_START && data->settled);
        const fo_real share = data->info.noise[0] * first->variance * square;
        c->inflation =
            inflation / (share < NOISE_SHARE_MAX ? ONE - share : ONE - NOISE_SHARE_MAX);
        c->best.variance *= c->inflation;
        c->second_weight =
            search->confirmations >= CONFIRMATIONS ? other / (ONE + other) : ONE / TWO;
        c->decided = stepped == best && (quick || data->trusted) && !*other_direction &&
                     search->confirmations >= CONFIRMATIONS && other < SECOND_WEIGHT_MAX &&
                     share < START_SHARE && c->best.variance < START_STD * START_STD;
    }
}

/* Answers with a candidate, or with a start from it. */
static void answer_candidate(const fo_candidate *c, fo_answer_kind kind, fo_answer *answer)
{
    answer->kind = kind;
    for (int i = 0; i < FO_N; i++) {
        answer->flux[i] = c->p[M_FLUX + i];
        answer->drift[i] = c->p[M_DRIFT + i];
    }
    answer->length = fo_sqrt(c->p[M_SQUARE]);
    answer->variance = c->variance;
}

/* Makes up to as many steps as there were samples since the last mail, at most one for each
 * candidate. */
static void fit(const fo_adaptive *a, fo_learner *s, const fo_mail *m, fo_search *search,
                fo_answer *answer)
{
    fo_manifold information;
    choice c;
    (void)memset(&c, 0, sizeof c);
    (void)memset(&information, 0, sizeof information);
    uint32_t steps = m->block.samples;
    steps = steps < (uint32_t)FO_CANDIDATES ? steps : (uint32_t)FO_CANDIDATES;
    while (steps > 0U && !c.decided) {
        const int stepped = (int)search->next;
        search->next = (search->next + 1U) % (uint32_t)FO_CANDIDATES;
        fo_gauss_newton_step(a, s, m, &search->candidates[stepped], &information);
        choose(a, s, m, search, stepped, &c, &answer->other_direction);
        steps--;
    }
    answer->other_weight = c.second_weight;
    if (c.has_best) {
        answer_candidate(&c.best, FO_ANSWER_CANDIDATE, answer);
        answer->other_theta = c.second_theta;
        if (c.decided && m->end.emf_ratio < EMF_RATIO_LIMIT &&
            fo_abs(m->data.search.rotation) > SWEEP) {
            fo_learning_start(a, s, &c.best, &information, c.inflation, &m->end);
            answer->kind = FO_ANSWER_START;
        }
    }
}

/* Starts the filter from the plain observer's solution. */
static void start_from_plain(const fo_adaptive *a, fo_learner *s, const fo_mail *m,
                             fo_search *search, fo_answer *answer)
{
    const fo_search_data *data = &m->data.search;
    fo_manifold information;
    fo_candidate c;
    c = search->candidates[0];
    for (int i = 0; i < FO_N; i++) {
        c.p[M_FLUX + i] = data->flux[i];
        c.p[M_DRIFT + i] = data->drift[i];
    }
    fo_gauss_newton_step(a, s, m, &c, &information);
    if (c.variance < START_STD_FROM_PLAIN * START_STD_FROM_PLAIN) {
        answer_candidate(&c, FO_ANSWER_START, answer);
        fo_learning_start(a, s, &c, &information, data->power > ONE ? data->power : ONE, &m->end);
    }
}

void fo_candidates_learn(const fo_adaptive *a, fo_learner *s, fo_search *search, const fo_mail *m,
                         fo_answer *answer)
{
    fo_real unused[2 * FO_N] = {0};
    if (m->forget && !s->frozen) {
        fo_learning_reset(a, s);
    }
    fo_learning_move_prior_means(a, s, unused, &unused[FO_N]);
    if (m->place) {
        place_candidates(a, s, m, search);
    } else {
        for (int k = 0; k < FO_CANDIDATES; k++) {
            fo_real *p = search->candidates[k].p;
            for (int i = 0; i < FO_N; i++) {
                p[M_FLUX + i] += m->block.volt_seconds[i] + m->block.time * p[M_DRIFT + i];
            }
        }
    }
    if (search->next == 0U) { /* once in a round, because it costs a substitution */
        fo_learning_update_voltage_std(a, s, &m->end);
    }
    answer->kind = FO_ANSWER_NONE;
    if (a->projection != FO_PROJECT_NEVER) {
        fit(a, s, m, search, answer);
    } else if (m->data.search.trusted && m->end.emf_ratio < EMF_RATIO_LIMIT) {
        start_from_plain(a, s, m, search, answer);
    } else {
        /* wait for the plain observer */
    }
    fo_learning_values(a, s, answer->value);
}
