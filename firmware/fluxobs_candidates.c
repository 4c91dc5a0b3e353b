/* SPDX-License-Identifier: MIT */
#include "fluxobs_candidates.h"

#include "fluxobs_internal.h"

#include <string.h>

/* The manifold's order; its last is the square of the magnet flux. */
enum { M_FLUX = 0, M_DRIFT = FO_N, M_SQUARE = 2 * FO_N };

/* ---- thresholds: unit, reason, and what fixed them --------------------------------------
 * "Benchmark" is the start in benchmarks/adaptive.py (worst of 40 unknown angles, 90 degrees after
 * the start); "tests" are in tests/observers/test_adaptive. */

/* Damping of the Gauss-Newton steps, as information [1, that of one sample]: a thousandth keeps the
 * matrix regular before there is a sample, and no longer matters after the first (tests). */
static const fo_real DAMPING = (fo_real)1e-3;
/* Candidates closer than 22.5 degrees, half of what each of the four covers to a side, are the
 * same: square of the cosine [1] (benchmark). */
static const fo_real SAME = (fo_real)0.8536;
/* Turns after which a candidate has converged [1]: Gauss-Newton doubles the digits in each, and
 * four reduce 22.5 degrees to less than noise (benchmark). */
static const uint32_t GROWN = 4U;
/* This many candidates have to converge to the same end [1]: one and a half rounds of the four, so
 * that no start in between is overlooked (benchmark); ... */
static const uint32_t SEARCHED = 6U;
/* ... and none elsewhere may have more than this weight [1], the chance of a wrong start
 * (benchmark). */
static const fo_real OTHER = (fo_real)0.01;
/* Share of the information that may come from noise at the start [1]: three times that of a valid
 * position, since the filter goes on judging (benchmark, noise 2.5 %). */
static const fo_real START_SHARE = (fo_real)0.3;
/* Upper bound of that share [1], so that the rest is not zero. */
static const fo_real SHARE_MOST = (fo_real)0.99;
/* Noise alone makes the costs of different angles differ; this many stds of that do not count [1]:
 * once in 30 000 starts (benchmark). */
static const fo_real FLUCTUATION = (fo_real)4;
/* Unknown errors of resistance and inverter may take this share of the EMF [1]; if they take more,
 * the start waits for the plain observer's position. A fifth turns the flux by 11 degrees
 * (benchmark). */
static const fo_real QUICK = (fo_real)0.2;
/* Upper bound of that share [1]: beyond a half there is no EMF to use. */
static const fo_real DISTURBANCE_MOST = (fo_real)0.5;
/* Smallest square of a magnet flux [flux bases]: a fifth of the assumed one; below it the candidate
 * has no direction (tests). */
static const fo_real SQUARE_LEAST = (fo_real)0.04;
/* Smallest square of a position vector that has a direction [flux bases]: a hundredth (tests). */
static const fo_real LENGTH_LEAST = (fo_real)1e-4;

static void position_of(const fo_adaptive *a, const fo_adaptive_state *s, const fo_candidate *c,
                     fo_real x[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        x[i] = c->p[M_FLUX + i] - away(&a->plain, &s->plain, i);
    }
}

/* The magnet flux as known; 0 without magnets. */
static fo_real magnet(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return a->psi > ZERO ? a->psi + a->std[FO_PSI] * s->p[FO_PSI] : ZERO;
}

static bool same(const fo_real x[FO_N], const fo_real y[FO_N])
{
    const fo_real product = dot(x, y);
    return product > ZERO && product * product > SAME * dot(x, x) * dot(y, y);
}

/* Sows a candidate in the direction of x. */
static void sow(const fo_adaptive *a, const fo_adaptive_state *s, const fo_real x[FO_N],
                fo_candidate *c)
{
    const fo_real psi = magnet(a, s);
    const fo_real length = fo_sqrt(dot(x, x)), longer = psi > ZERO ? psi : ONE;
    (void)memset(c, 0, sizeof *c);
    for (int i = 0; i < FO_N; i++) {
        const fo_real along = length > ZERO ? x[i] / length : i == 0 ? ONE : ZERO;
        c->p[M_FLUX + i] = longer * along + away(&a->plain, &s->plain, i);
    }
    c->p[M_SQUARE] = psi * psi;
    c->theta = fo_atan2(x[1], x[0]);
    c->variance = VARIANCE_UNKNOWN;
}

void fo_candidates_sow(const fo_adaptive *a, fo_adaptive_state *s)
{
    fo_real x[FO_N] = {s->x[0], s->x[1]};
    if (s->plain.trusted) {
        for (int i = 0; i < FO_N; i++) {
            x[i] = s->plain.x[FLUX + i] - away(&a->plain, &s->plain, i);
        }
    }
    for (int k = 0; k < FO_CANDIDATES; k++) { /* a quarter of a turn apart */
        const fo_real before = x[0];
        sow(a, s, x, &s->now.start.candidates[k]);
        x[0] = -x[1];
        x[1] = before;
    }
    s->running = false;
    s->now.start.searched = 0U;
    s->now.start.best = 0;
}

/* Share of the EMF that may come from errors of resistance and inverter. */
static fo_real disturbance(const fo_adaptive_state *s)
{
    return s->doubt < DISTURBANCE_MOST ? s->doubt : DISTURBANCE_MOST;
}

/* Starts the information with damping and the assumed magnet flux, whose variance includes the
 * effect of unknown errors of resistance and inverter. */
static void believe(const fo_adaptive *a, const fo_adaptive_state *s, const fo_candidate *c,
                  fo_manifold *m)
{
    const fo_real psi = magnet(a, s), square = psi * psi, doubt = disturbance(s);
    const fo_real variance =
        (fo_real)4 * square * (a->std[FO_PSI] * a->std[FO_PSI] + doubt * doubt * square);
    (void)memset(m, 0, sizeof *m);
    for (int i = 0; i < FO_NM; i++) {
        m->d[i] = DAMPING;
    }
    m->d[M_SQUARE] = ONE / (variance + (fo_real)1e-6);
    m->z[M_SQUARE] = square - c->p[M_SQUARE];
}

void fo_project(const fo_adaptive *a, const fo_adaptive_state *s, fo_candidate *c, fo_manifold *m)
{
    const fo_information *info = &s->plain.info;
    fo_real x_before[FO_N];
    position_of(a, s, c, x_before);
    const fo_real *flux = &c->p[M_FLUX], *drift = &c->p[M_DRIFT], *u = info->U;
    fo_real full[FO_NX], at[FO_NX], x[FO_N], row[FO_NM], least = ZERO;

    /* docs/theory.md, section 13: the immersion's state is a function of the manifold's. */
    at[S] = dot(flux, flux) - c->p[M_SQUARE];
    at[KAPPA] = TWO * dot(flux, drift);
    at[CC] = dot(drift, drift);
    for (int i = 0; i < FO_N; i++) {
        at[FLUX + i] = flux[i];
        at[DRIFT + i] = drift[i];
    }
    believe(a, s, c, m);
    fo_real cost = m->d[M_SQUARE] * m->z[M_SQUARE] * m->z[M_SQUARE];
    (void)memset(full, 0, sizeof full);
    for (int j = 0; j < FO_NX; j++) { /* U_j (x - x(p)), and its derivative by p */
        fo_real off = info->z[j] - at[j];
        if (j > 0) {
            full[j - 1] = ZERO;
        }
        full[j] = ONE;
        for (int k = j + 1; k < FO_NX; k++) {
            full[k] = *u;
            off -= *u * at[k];
            u++;
        }
        for (int i = 0; i < FO_N; i++) {
            row[M_FLUX + i] = full[FLUX + i] + TWO * (full[S] * flux[i] + full[KAPPA] * drift[i]);
            row[M_DRIFT + i] =
                full[DRIFT + i] + TWO * (full[KAPPA] * flux[i] + full[CC] * drift[i]);
        }
        row[M_SQUARE] = -full[S];
        cost += info->d[j] * off * off;
        fo_real value = off, weight = info->d[j];
        fo_rotate(FO_NM, m->U, m->d, m->z, 0, FO_NM, row, &value, &weight);
        least += weight * value * value;
    }
    /* Current noise in the rows adds noise psi^2 to the cost, which pulls psi to zero: subtract it.
     * It is linear in the last unknown, and so moves nothing else in the triangle. Nothing known of
     * that unknown: nothing to move. */
    const fo_real noise = info->noise[0], known = m->d[M_SQUARE];
    const fo_real shift = known > ZERO ? noise / (TWO * known) : ZERO;
    least -= known * shift * shift;
    m->z[M_SQUARE] += shift;
    c->cost = cost - noise * c->p[M_SQUARE];

    fo_real step[FO_NM];
    fo_solve(FO_NM, m->U, m->z, 0, FO_NM, step);
    for (int i = 0; i < FO_NM; i++) {
        c->p[i] += step[i];
    }
    const fo_real lowest = a->psi > ZERO ? SQUARE_LEAST : ZERO;
    c->p[M_SQUARE] = c->p[M_SQUARE] > lowest ? c->p[M_SQUARE] : lowest;
    c->least = least - noise * c->p[M_SQUARE];
    position_of(a, s, c, x);
    c->age = same(x, x_before) ? c->age + 1U : 0U; /* after a leap it has to settle again */
    const fo_real square = dot(x, x), all = dot(drift, drift) + c->p[M_SQUARE] + c->cost + c->least;
    if (square > LENGTH_LEAST && square < RUNAWAY && all - all == ZERO) {
        fo_real y[FO_NM] = {-x[1], x[0], ZERO, ZERO, ZERO};
        c->theta = fo_atan2(x[1], x[0]);
        c->variance = fo_variance(FO_NM, m->U, m->d, 0, FO_NM, y);
        c->variance /= square * square;
        c->variance = c->variance < VARIANCE_UNKNOWN ? c->variance : VARIANCE_UNKNOWN;
    } else { /* gone astray, or not a number */
        const fo_real across[FO_N] = {-s->x[1], s->x[0]};
        sow(a, s, across, c);
    }
}

/* The grown candidate with the least cost, or -1. */
static int likeliest(const fo_adaptive_state *s)
{
    int best = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &s->now.start.candidates[k];
        if (c->age >= GROWN && (best < 0 || c->cost < s->now.start.candidates[best].cost)) {
            best = k;
        }
    }
    return best;
}

/* The likeliest grown candidate elsewhere, or -1; one that came to the same end is sown again. */
static int rival(const fo_adaptive *a, fo_adaptive_state *s, int best)
{
    int second = -1;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        const fo_candidate *c = &s->now.start.candidates[k];
        if (k != best && c->age >= GROWN) {
            fo_real x[FO_N], y[FO_N];
            position_of(a, s, &s->now.start.candidates[best], x);
            position_of(a, s, c, y);
            if (same(x, y)) {
                for (uint32_t quarters = 1U + s->now.start.searched % 3U; quarters > 0U; quarters--) {
                    const fo_real before = x[0];
                    x[0] = -x[1];
                    x[1] = before;
                }
                sow(a, s, x, &s->now.start.candidates[k]);
                s->now.start.searched++;
            } else if (second < 0 || c->least < s->now.start.candidates[second].least) {
                second = k;
            } else {
                /* neither the best nor the second */
            }
        }
    }
    return second;
}

/* About exp(-x), x >= 0. */
static fo_real decay(fo_real x)
{
    const fo_real third = ONE + x / (fo_real)3 * (ONE + x / (fo_real)4);
    return ONE / (ONE + x * (ONE + x / TWO * third));
}

/* Likelihood of the second relative to the best, whose position vector has this square. */
static fo_real against(const fo_adaptive *a, const fo_adaptive_state *s, const fo_candidate *best,
                       const fo_candidate *second, fo_real square, fo_real inflation)
{
    const fo_real noise = TWO * a->plain.noise_information * s->plain.info.noise[0];
    const fo_real chance = FLUCTUATION * fo_sqrt(noise) * square;
    const fo_real x = (second->least - best->cost - chance) / (TWO * inflation);
    return decay(x > ZERO ? x : ZERO);
}

void fo_candidates_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real v[FO_N],
                        fo_choice *choice)
{
    const uint32_t round = s->turn % (uint32_t)FO_CANDIDATES;
    const int due = (int)round;
    for (int k = 0; k < FO_CANDIDATES; k++) {
        fo_real *p = s->now.start.candidates[k].p;
        for (int i = 0; i < FO_N; i++) {
            p[M_FLUX + i] += v[i] + a->plain.h * p[M_DRIFT + i];
        }
    }
    fo_project(a, s, &s->now.start.candidates[due], &choice->information);

    const int best = likeliest(s);
    choice->found = best >= 0;
    choice->decided = false;
    choice->weight = ONE / TWO;
    if (choice->found) {
        fo_candidate *c = &s->now.start.candidates[best];
        const fo_real power = s->plain.power;
        const fo_real inflation = power > ONE ? power : ONE;
        fo_real x[FO_N], other = ZERO;
        position_of(a, s, c, x);
        if (s->now.start.best != best) {
            fo_real before[FO_N];
            position_of(a, s, &s->now.start.candidates[s->now.start.best], before);
            if (!same(x, before) || s->now.start.candidates[s->now.start.best].age < GROWN) {
                s->now.start.searched = 0U;
                s->tracker.settled = ZERO;
            }
            s->now.start.best = best;
        }
        const fo_real square = dot(x, x);
        const int second = rival(a, s, best);
        choice->other = c->theta;
        if (second >= 0) {
            choice->other = s->now.start.candidates[second].theta;
            other = against(a, s, c, &s->now.start.candidates[second], square, inflation);
            s->now.start.searched = other > OTHER ? 0U : s->now.start.searched;
        }
        choice->best = *c;
        choice->best.theta = fo_atan2(x[1], x[0]);
        track(&a->plain, &s->tracker, choice->best.theta);
        settle_tracker(&a->plain, &s->tracker, choice->best.theta, fo_sqrt(c->variance));
        const bool quick = !(s->doubt > ZERO) ||
                           (s->doubt < QUICK && s->tracker.settled >= TRACKER_SETTLED);
        const fo_real share = s->plain.info.noise[0] * c->variance * square;
        choice->inflation = inflation / (share < SHARE_MOST ? ONE - share : ONE - SHARE_MOST);
        choice->best.variance *= choice->inflation;
        choice->weight = s->now.start.searched >= SEARCHED ? other / (ONE + other) : ONE / TWO;
        choice->decided = due == best && (quick || s->plain.trusted) &&
                          s->now.start.searched >= SEARCHED && other < OTHER && share < START_SHARE &&
                          choice->best.variance < START_STD * START_STD;
    }
}
