/* SPDX-License-Identifier: MIT */
#include "fluxobs_adaptive.h"

#include "fluxobs_internal.h"
#include "fluxobs_learning.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what fixed them --------------------------------------- */

/* The two parts of the inverter's loss saturate at these multiples of the current given: with both
 * and a resistance, any curve is met to within a few percent of the loss [1]. */
static const fo_real HARD = (fo_real)0.2;
static const fo_real SOFT = (fo_real)1.2;
/* The rest, i (1 - |i| / I) / I with I this multiple, which is rated current by default [1] ... */
static const fo_real RATED = (fo_real)20;
/* ... and its std, of the loss [1]: at most a quarter of it, 4 % of the loss. */
static const fo_real CURVE_STD = (fo_real)0.15;
/* A voltage error of this share of the drift's prior is in no model [1]: it limits for how long the
 * filter trusts the voltage, ... */
static const fo_real UNMODELLED = (fo_real)0.1;
/* ... and, as a slow turn by it leaves no trace in the residual, this one a valid position [1]. */
static const fo_real EXPOSED = (fo_real)0.05;
/* Std of the angle above which linearising makes no sense: 30 degrees [rad]. */
static const fo_real STD_LOST = PI / (fo_real)6;
/* Std of an angle, with what inductance and lag may turn it, above which it is not valid: 10
 * degrees [rad]. */
static const fo_real STD_ALL = PI / (fo_real)18;
/* Rows of the filter before its position is valid, and before it may be lost for its std [1]. */
static const fo_real PROVEN_AFTER = (fo_real)4;
static const fo_real LOST_AFTER = (fo_real)2;
/* Rows within which a filter that is lost has learnt nothing worth keeping: two turns [1]. */
static const fo_real EARLY = (fo_real)16;
/* The filter is wrong if it contradicts what has been learnt by this power [1], ten stds, ... */
static const fo_real CONTRADICTION_MOST = (fo_real)100;
/* ... learns a resistance that is this many stds off its prior [1], ... */
static const fo_real FAR = (fo_real)4;
/* ... or differs from its guard by 20 degrees for a turn [rad, rad]. */
static const fo_real DISAGREE = PI / (fo_real)9;
static const fo_real DISAGREE_FOR = TWO * PI;

/* ---- configuration -------------------------------------------------------------------- */

static void prepare_adaptive(fo_adaptive *a, const fo_config *config, const fo_adaptive_config *c)
{
    const fo_real psi = config->flux_base;
    const fo_real through_L = (config->L_position + c->saliency) * config->current_noise / psi;
    const fo_real half = c->inverter_std / fo_sqrt(TWO);
    const fo_real stds[FO_NP] = {
        c->psi_f_std / psi, c->resistance_std, half, half, c->offset_std, c->offset_std,
        c->L_d_std,         c->L_q_std,
#if FO_ASYMMETRIC
        c->asymmetry_std,   c->asymmetry_std,
#endif
        CURVE_STD,
    };
    a->saliency = c->saliency / psi;
    a->psi = c->psi_f / psi;
    for (int i = 0; i < FO_NP; i++) {
        a->std[i] = stds[i];
    }
    a->inverter_mean = c->inverter_voltage / TWO;
    a->volt = config->sample_time / psi;
    a->over_current[0] = ONE / (HARD * c->inverter_current);
    a->over_current[1] = ONE / (SOFT * c->inverter_current);
    a->over_rated = ONE / (RATED * c->inverter_current);
    a->lag_std = c->lag_std;
    a->through_L = through_L * through_L;
    a->unmodelled = UNMODELLED * a->plain.plausible;
    a->slow = config->memory / c->slow_memory;
    a->projection = c->projection;
}

static finding check_adaptive(const fo_adaptive *a, const fo_adaptive_config *c)
{
    const fo_real high = (fo_real)1e9, million = (fo_real)1e6;
    finding found = {FO_OK, NULL};
    demand_size(&found, a->saliency * a->plain.current_limit, -million, million, "saliency");
    demand_size(&found, a->over_current[0], (fo_real)1e-9, high, "inverter_current");
    demand_size(&found, a->through_L, ZERO, million, "saliency");
    demand_size(&found, c->slow_memory, ZERO, high, "slow_memory");
    demand_size(&found, c->lag_std, ZERO, high, "lag_std");
    demand_size(&found, c->inverter_voltage, ZERO, high, "inverter_voltage");
    demand_size(&found, a->psi, ZERO, (fo_real)1e3, "psi_f");
    demand_size(&found, a->std[FO_PSI], ZERO, high, "psi_f_std");
    demand_size(&found, a->std[FO_RESISTANCE], ZERO, high, "resistance_std");
    demand_size(&found, a->std[FO_INVERTER], ZERO, high, "inverter_std");
    demand_size(&found, a->std[FO_OFFSET], ZERO, high, "offset_std");
    demand_size(&found, a->std[FO_INDUCTANCE], ZERO, high, "L_d_std");
    demand_size(&found, a->std[FO_INDUCTANCE + 1], ZERO, high, "L_q_std");
#if FO_ASYMMETRIC
    demand_size(&found, a->std[FO_ASYMMETRY], ZERO, high, "asymmetry_std");
#endif
    return found;
}

static finding examine_adaptive(fo_adaptive *a, const fo_config *config,
                                const fo_adaptive_config *c)
{
    finding found = {fo_init(&a->plain, config), NULL};
    if (found.error != FO_OK) {
        found.field = fo_wrong(config);
    }
    demand(&found, c->inverter_current > ZERO, FO_ERROR_BASE, "inverter_current");
    demand(&found, c->slow_memory > ZERO, FO_ERROR_BASE, "slow_memory");
#if !FO_ASYMMETRIC
    demand(&found, !(c->asymmetry_std > ZERO), FO_ERROR_OTHER, "asymmetry_std");
#endif
    demand_size(&found, c->inverter_current, (fo_real)1e-9, (fo_real)1e9, "inverter_current");
    if (found.error == FO_OK) {
        prepare_adaptive(a, config, c);
        found = check_adaptive(a, c);
    }
    return found;
}

fo_error fo_adaptive_init(fo_adaptive *a, const fo_config *config, const fo_adaptive_config *c)
{
    return examine_adaptive(a, config, c).error;
}

const char *fo_adaptive_wrong(const fo_config *config, const fo_adaptive_config *c)
{
    fo_adaptive a;
    return examine_adaptive(&a, config, c).field;
}

void fo_adaptive_reset(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s, 0, sizeof *s);
    fo_reset(&a->plain, &s->plain);
    fo_learning_forget(a, s);
    s->x[0] = ONE;
    fo_candidates_sow(a, s);
}

void fo_adaptive_restart(const fo_adaptive *a, fo_adaptive_state *s, bool frozen)
{
    fo_adaptive_state before;
    before = *s;
    fo_adaptive_reset(a, s);
    (void)memcpy(s->U, before.U, sizeof s->U);
    (void)memcpy(s->d, before.d, sizeof s->d);
    (void)memcpy(s->z, before.z, sizeof s->z);
    (void)memcpy(s->p, before.p, sizeof s->p);
    (void)memcpy(s->deviations, before.deviations, sizeof s->deviations);
    s->frozen = frozen;
    fo_candidates_sow(a, s);
}

/* ---- the inverter --------------------------------------------------------------------- */

/* tanh(x) to within 0.0014: its Pade approximant, clipped where that reaches 1. */
static fo_real soft_sign(fo_real x)
{
    const fo_real square = x * x;
    fo_real sign = x > ZERO ? ONE : -ONE;
    if (square < (fo_real)13.298) {
        sign = x * ((fo_real)945 + square * ((fo_real)105 + square)) /
               ((fo_real)945 + square * ((fo_real)420 + (fo_real)15 * square));
    }
    return sign;
}

/* Amplitude-invariant vector of the signs of the phase currents; adds its derivative (alpha alpha,
 * alpha beta, beta beta) by the current, times `volts`. Returns how unsure they are, 0 to 1. */
static fo_real direction(const fo_real current[FO_N], fo_real over, fo_real volts,
                      fo_real signs[FO_N], fo_real bend[3])
{
    const fo_real half = current[0] / TWO, root = (fo_real)0.8660254037844386 * current[1];
    const fo_real phases[3] = {soft_sign(current[0] * over), soft_sign((root - half) * over),
                               soft_sign((-root - half) * over)};
    fo_real steep[3];
    for (int i = 0; i < 3; i++) {
        steep[i] = volts * over * (ONE - phases[i] * phases[i]);
    }
    signs[0] = (TWO * phases[0] - phases[1] - phases[2]) / (fo_real)3;
    signs[1] = (phases[1] - phases[2]) * (fo_real)0.5773502691896258;
    bend[0] += ((fo_real)4 * steep[0] + steep[1] + steep[2]) / (fo_real)6;
    bend[1] += (steep[2] - steep[1]) * (fo_real)0.2886751345948129;
    bend[2] += (steep[1] + steep[2]) / TWO;
    return ONE - (phases[0] * phases[0] + phases[1] * phases[1] + phases[2] * phases[2]) / (fo_real)3;
}

/* Voltage of each part of the inverter's loss. */
static fo_real part(const fo_adaptive *a, const fo_adaptive_state *s, int n)
{
    return a->inverter_mean + fo_learning_value(a, s, FO_INVERTER + n);
}

/* What has been learnt about the interval that ends with this current: the voltage lost beyond the
 * assumed resistance, without the asymmetry. Keeps the signs. */
static void known_loss(const fo_adaptive *a, fo_adaptive_state *s, const fo_real current[FO_N],
                       fo_real lost[FO_N])
{
    const fo_state *q = &s->plain;
    fo_real mean[FO_N], inside[FO_N];
    for (int i = 0; i < FO_N; i++) {
        mean[i] = current[i];
        if (q->have_current) {
            mean[i] = mean_current_24(current[i], q->current[0][i], q->current[1][i],
                                      q->current[2][i]) /
                      (fo_real)24;
        }
    }
    if (!(dot(mean, mean) <= a->plain.current_limit * a->plain.current_limit)) {
        mean[0] = q->current[0][0]; /* not a number, or absurd */
        mean[1] = q->current[0][1];
    }
    for (int i = 0; i < FO_N; i++) {
        inside[i] = mean[i] - fo_learning_value(a, s, FO_OFFSET + i);
        lost[i] = fo_learning_value(a, s, FO_RESISTANCE) * mean[i];
    }
    (void)memset(s->bend, 0, sizeof s->bend);
    for (int n = 0; n < 2; n++) {
        const fo_real volts = part(a, s, n);
        const fo_real unsure = direction(inside, a->over_current[n], volts, s->signs[n], s->bend);
        s->knee = n == 0 ? unsure : s->knee;
        for (int i = 0; i < FO_N; i++) {
            lost[i] += volts * s->signs[n][i];
        }
    }
}

/* u + g conj(u) */
static void straighten(const fo_adaptive *a, const fo_adaptive_state *s, const fo_real u[FO_N],
                       fo_real straight[FO_N])
{
    straight[0] = u[0];
    straight[1] = u[1];
#if FO_ASYMMETRIC
    const fo_real g0 = fo_learning_value(a, s, FO_ASYMMETRY);
    const fo_real g1 = fo_learning_value(a, s, FO_ASYMMETRY + 1);
    straight[0] += g0 * u[0] + g1 * u[1];
    straight[1] += g1 * u[0] - g0 * u[1];
#else
    (void)a;
    (void)s;
#endif
}

/* Volt-seconds of the last interval, and what one std of each parameter adds to them. */
static void integrate(const fo_adaptive *a, const fo_adaptive_state *s, bool complete,
                      fo_effects *t)
{
    const fo_real volts = part(a, s, 0) + part(a, s, 1);
    fo_real mean[FO_N], mean_24[FO_N], u[FO_N];
    for (int i = 0; i < FO_N; i++) {
        mean_24[i] = mean_current_24(s->plain.current[0][i], s->plain.current[1][i],
                                     s->plain.current[2][i], s->plain.current[3][i]);
        mean[i] = mean_24[i] / (fo_real)24;
    }
    const fo_real share = fo_sqrt(dot(mean, mean)) * a->over_rated;
    const fo_real *std = a->std, *bend = s->bend;
    for (int i = 0; i < FO_N; i++) {
        const fo_real drop = row_of(a->plain.hR, i, mean_24);
        t->v[i] = s->plain.source[i] - (complete ? ZERO : drop);
        u[i] = s->plain.source[i] + (complete ? drop : ZERO);
        t->effect[FO_PSI][i] = ZERO;
        t->effect[FO_RESISTANCE][i] = -std[FO_RESISTANCE] * a->volt * mean[i];
        t->effect[FO_INVERTER][i] = -std[FO_INVERTER] * a->volt * s->signs[0][i];
        t->effect[FO_INVERTER + 1][i] = -std[FO_INVERTER + 1] * a->volt * s->signs[1][i];
        t->effect[FO_OFFSET][i] = std[FO_OFFSET] * a->volt * bend[i];
        t->effect[FO_OFFSET + 1][i] = std[FO_OFFSET + 1] * a->volt * bend[1 + i];
        t->effect[FO_INDUCTANCE][i] = ZERO;
        t->effect[FO_INDUCTANCE + 1][i] = ZERO;
        t->effect[FO_CURVE][i] =
            -std[FO_CURVE] * a->volt * volts * mean[i] * a->over_rated * (ONE - share);
    }
#if FO_ASYMMETRIC
    t->effect[FO_ASYMMETRY][0] = std[FO_ASYMMETRY] * u[0];
    t->effect[FO_ASYMMETRY][1] = -std[FO_ASYMMETRY] * u[1];
    t->effect[FO_ASYMMETRY + 1][0] = std[FO_ASYMMETRY + 1] * u[1];
    t->effect[FO_ASYMMETRY + 1][1] = std[FO_ASYMMETRY + 1] * u[0];
#else
    (void)u;
#endif
}

/* ---- the filter, guarded -------------------------------------------------------------- */

/* Lets the filter go; what was learnt stays, unless it did harm. */
static void stop(const fo_adaptive *a, fo_adaptive_state *s, bool harm)
{
    if (harm) {
        s->restarts++;
    }
    if (harm && !s->frozen) {
        fo_learning_forget(a, s);
    }
    fo_candidates_sow(a, s);
}

/* Std of an angle with this variance: at most that of an unknown one. */
static fo_real std_of(fo_real variance)
{
    return fo_sqrt(variance < VARIANCE_UNKNOWN ? variance : VARIANCE_UNKNOWN);
}

/* Writes what the estimate says about the parameters. */
static void report_parameters(const fo_adaptive *a, const fo_adaptive_state *s,
                              fo_adaptive_estimate *e)
{
    e->psi_f_std = s->deviations[0] * a->plain.flux_base;
    e->resistance_error = fo_learning_value(a, s, FO_RESISTANCE);
    e->resistance_std = s->deviations[1];
    e->inverter_voltage = part(a, s, 0) + part(a, s, 1);
    e->inverter_std = s->deviations[2];
}

/* Writes the estimate of the filter, with this position vector and the variance of its angle. */
static void report(const fo_adaptive *a, const fo_adaptive_state *s, fo_real length,
                   fo_real variance, fo_real fixed, fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_estimate *q = &e->position;
    const fo_real all = variance + fixed;
    for (int i = 0; i < FO_N; i++) {
        q->flux[i] = s->flux[i] * o->flux_base;
        q->drift[i] = s->drift[i] * o->drift_base;
    }
    q->psi_f = length * o->flux_base;
    q->theta_e = s->theta;
    q->theta_e_tracked = s->tracker.angle;
    q->speed_e = s->tracker.speed;
    /* what may be unmodelled is a bound: its std is that over the root of three */
    q->theta_e_std = std_of(all - TWO / (fo_real)3 * s->exposed * s->exposed);
    q->noise_share = ZERO;
    q->valid = s->rows > PROVEN_AFTER && s->tracker.settled >= TRACKER_SETTLED &&
               s->doubt < DOUBT_LIMIT && variance < STD_LIMIT * STD_LIMIT &&
               all < STD_ALL * STD_ALL;
    e->psi_f = (a->psi + fo_learning_value(a, s, FO_PSI)) * o->flux_base;
#if FO_MAPPED
    if (cage(o)) {
        e->psi_f += s->plain.shape.active * o->flux_base;
    }
#endif
    const fo_real known = fo_sqrt(s->d[FO_N]) * o->plausible; /* over what the prior knew */
    e->drift_std = o->plausible * o->drift_base / (known > ONE ? known : ONE);
    e->theta_other = q->theta_e;
    e->weight_other = ZERO;
}

/* Are all numbers of an estimate finite? */
static bool finite_numbers(const fo_adaptive_estimate *e)
{
    const fo_estimate *q = &e->position;
    const fo_real sum = q->flux[0] + q->flux[1] + q->drift[0] + q->drift[1] + q->psi_f +
                        q->theta_e + q->speed_e + q->theta_e_std + e->psi_f + e->psi_f_std +
                        e->drift_std + e->resistance_error + e->resistance_std +
                        e->inverter_voltage + e->inverter_std;
    return sum - sum == ZERO;
}

/* The position of the observer inside, which takes the parameters for known. */
static void take_inside(const fo_adaptive_state *s, const fo_estimate *inside,
                        fo_adaptive_estimate *e)
{
    fo_estimate *q = &e->position;
    *q = *inside;
    q->theta_e_std = std_of(inside->theta_e_std * inside->theta_e_std + s->doubt * s->doubt);
    q->valid = inside->valid && q->theta_e_std < STD_LIMIT;
}

/* A sample while the filter runs. */
static void run(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t, bool measured,
                fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_adaptive_estimate plain;
    plain = *e;
    const fo_real guard = e->position.theta_e;
    const bool known = e->position.valid;
    const fo_real length = fo_learning_sample(a, s, t, measured);
    const fo_real square = length * length;
    if (square > ZERO) {
        const fo_real turned = fo_abs(s->tracker.speed) * o->sample_time;
        const fo_real step = turned < ONE ? turned : ONE;
        track(o, &s->tracker, s->theta);
        fo_learning_doubt(a, s, t, length, turned);
        const fo_real inverter = fo_learning_unmodelled(a, s) * o->h;
        const fo_real plausible = EXPOSED * o->plausible * o->h;
        s->exposed += (plausible + inverter) / length - s->exposed * step;
        const fo_real noise = o->position_noise * s->plain.roughness;
        const fo_real variance =
            (s->across + fo_learning_since(s) + noise) / square + s->exposed * s->exposed;
        const fo_real late = a->lag_std * s->tracker.speed; /* a lag leaves no trace at all */
        settle_tracker(o, &s->tracker, s->theta, fo_sqrt(variance));
        report(a, s, length, variance,
               s->turned / square + late * late + rippled(o, s->tracker.speed), e);
        const bool off = known && fo_abs(wrap(s->theta - guard)) > DISAGREE;
        s->disagree = off ? s->disagree + step : known ? ZERO : s->disagree;
        report_parameters(a, s, e);
        const bool sound = finite_numbers(e);
        if (!sound) {
            *e = plain;
        } else if (known && !(s->rows > PROVEN_AFTER)) {
            take_inside(s, &plain.position, e);
        } else {
            /* the filter's own position */
        }
        const bool harm = !sound || s->disagree > DISAGREE_FOR ||
                          s->contradiction > CONTRADICTION_MOST ||
                          fo_abs(s->p[FO_RESISTANCE]) > FAR ||
                          fo_abs(s->p[FO_INDUCTANCE]) > FAR ||
                          fo_abs(s->p[FO_INDUCTANCE + 1]) > FAR;
        const bool lost = s->doubt > ONE ||
                          (s->rows > LOST_AFTER && !(variance < STD_LOST * STD_LOST));
        /* what little a filter has learnt that is lost within two turns is worth nothing */
        const bool early = lost && s->rows < EARLY &&
                           s->deviations[1] > a->std[FO_RESISTANCE] / TWO;
        if (harm || lost) {
            stop(a, s, harm || early);
        }
    } else {
        stop(a, s, true);
    }
}

/* ---- the start ------------------------------------------------------------------------ */

static void begin(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t,
                  fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_estimate *q = &e->position;
    fo_choice choice;
    fo_learning_doubt(a, s, t, s->plain.length,
                      s->plain.trusted ? fo_abs(s->plain.tracker.speed) * o->sample_time : ZERO);
    if (a->projection != FO_PROJECT_NEVER) {
        fo_candidates_step(a, s, t->v, &choice);
        e->weight_other = choice.weight;
        if (choice.found && choice.weight < ONE / TWO) {
            e->theta_other = choice.other;
        }
        s->seeded = s->seeded && !s->plain.trusted && q->theta_e_std < std_of(VARIANCE_UNKNOWN);
        if (s->plain.trusted) {
            fo_estimate inside;
            inside = *q;
            take_inside(s, &inside, e);
        } else if (choice.found && !s->seeded) {
            fo_real variance = choice.best.variance;
            const fo_real apart = wrap(choice.other - choice.best.theta);
            variance += choice.weight * apart * apart;
            q->theta_e = choice.best.theta;
            q->theta_e_tracked = s->tracker.angle;
            q->speed_e = s->tracker.speed;
            q->theta_e_std = std_of(variance);
            for (int i = 0; i < FO_N; i++) {
                q->flux[i] = choice.best.p[i] * o->flux_base;
                q->drift[i] = choice.best.p[FO_N + i] * o->drift_base;
            }
            q->psi_f = fo_sqrt(choice.best.p[2 * FO_N]) * o->flux_base;
            q->valid = false;
        } else {
            /* nothing is known */
        }
        const bool one = choice.found && choice.weight < ONE / TWO;
        s->swept = one ? s->swept + wrap(choice.best.theta - s->theta) : ZERO;
        s->theta = choice.found ? choice.best.theta : s->theta;
        if (choice.decided && s->doubt < DOUBT_LIMIT && fo_abs(s->swept) > SWEEP) {
            fo_learning_start(a, s, &choice.best, &choice.information, choice.inflation, t);
        }
    } else if (s->plain.trusted && s->doubt < DOUBT_LIMIT) {
        fo_manifold information;
        fo_candidate c;
        c = s->now.start.candidates[0];
        const fo_real power = s->plain.power;
        for (int i = 0; i < FO_N; i++) {
            c.p[i] = s->plain.x[FLUX + i];
            c.p[FO_N + i] = s->plain.x[DRIFT + i];
        }
        s->tracker = s->plain.tracker;
        fo_project(a, s, &c, &information);
        if (c.variance < STD_LOST * STD_LOST) {
            fo_learning_start(a, s, &c, &information, power > ONE ? power : ONE, t);
        }
    } else {
        /* it waits */
    }
}

/* ---- samples -------------------------------------------------------------------------- */

typedef struct {
    uint32_t voltages, currents;
} bad_samples;

static bad_samples bad_so_far(const fo_state *q)
{
    const bad_samples found = {q->bad_voltages, q->bad_currents + q->outliers};
    return found;
}

/* After the plain observer's step: the rest of the sample. */
static void go_on(const fo_adaptive *a, fo_adaptive_state *s, bool complete, bad_samples before,
                  fo_adaptive_estimate *e)
{
    const bad_samples now = bad_so_far(&s->plain);
    const bool measured = now.currents == before.currents;
    e->theta_other = e->position.theta_e;
    e->weight_other = e->position.valid ? ZERO : ONE / TWO;
    e->psi_f = e->position.psi_f;
    e->drift_std = a->plain.plausible * a->plain.drift_base;
    if (s->plain.have_current && s->plain.have_voltage) {
        fo_effects t;
        integrate(a, s, complete, &t);
        e->adapting = s->running;
        if (s->running) {
            run(a, s, &t, measured, e);
        } else {
            begin(a, s, &t, e);
        }
    } else {
        e->adapting = false;
        if (!s->plain.have_current && s->running) {
            stop(a, s, false);
        }
        s->doubt = TWO;
    }
    s->turn++;
    if (!e->adapting || !s->running) { /* else it is done, and nothing has changed since */
        report_parameters(a, s, e);
    }
    e->position.valid = e->position.valid && measured && now.voltages == before.voltages;
}

/* While the filter runs and the guard has no position of its own, the map is asked at the filter's
 * angle; else at the guard's, which must not depend on what it guards. */
static void guide(const fo_adaptive *a, fo_adaptive_state *s)
{
#if FO_MAPPED
    s->plain.guided = s->running && !s->plain.trusted;
    s->plain.guide = expected_angle(&a->plain, &s->tracker);
#else
    (void)a;
    (void)s;
#endif
}

static void ready(const fo_adaptive *a, fo_adaptive_state *s)
{
    if (fo_damaged(&a->plain, &s->plain)) {
        const uint32_t restarts = s->plain.restarts;
        fo_adaptive_reset(a, s);
        s->plain.restarts = restarts + 1U;
    }
}

void fo_adaptive_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real voltage[FO_N],
                      const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    ready(a, s);
    const bad_samples before = bad_so_far(&s->plain);
    fo_real lost[FO_N], left[FO_N];
    known_loss(a, s, current, lost);
    straighten(a, s, voltage, left);
    for (int i = 0; i < FO_N; i++) {
        left[i] -= lost[i];
    }
    guide(a, s);
    fo_step(&a->plain, &s->plain, left, current, &e->position);
    go_on(a, s, false, before, e);
}

void fo_adaptive_step_volt_seconds(const fo_adaptive *a, fo_adaptive_state *s,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *e)
{
    ready(a, s);
    const bad_samples before = bad_so_far(&s->plain);
    fo_real lost[FO_N], left[FO_N];
    known_loss(a, s, current, lost);
    straighten(a, s, volt_seconds, left);
    for (int i = 0; i < FO_N; i++) {
        left[i] -= a->plain.sample_time * lost[i];
    }
    guide(a, s);
    fo_step_volt_seconds(&a->plain, &s->plain, left, current, &e->position);
    go_on(a, s, true, before, e);
}

void fo_adaptive_step_for(const fo_adaptive *a, fo_adaptive_state *s, fo_real duration,
                          const fo_real voltage[FO_N], const fo_real current[FO_N],
                          fo_adaptive_estimate *e)
{
    fo_adaptive now;
    fo_gathered g;
    now = *a;
    fo_uneven(&a->plain, &s->plain, duration, voltage, current, &now.plain, &g);
    now.volt = a->volt * (now.plain.sample_time / a->plain.sample_time);
    fo_adaptive_step_volt_seconds(&now, s, g.volt_seconds, g.current, e);
}

void fo_adaptive_learnt(const fo_adaptive *a, const fo_adaptive_state *s, fo_learnt *l)
{
    const fo_real base = a->plain.flux_base;
    l->psi_f = (a->psi + fo_learning_value(a, s, FO_PSI)) * base;
    l->psi_f_std = fo_learning_deviation(a, s, FO_PSI, 1, ZERO) * base;
    l->resistance_error = fo_learning_value(a, s, FO_RESISTANCE);
    l->resistance_std = fo_learning_deviation(a, s, FO_RESISTANCE, 1, ZERO);
    l->inverter_voltage = part(a, s, 0) + part(a, s, 1);
    l->inverter_std = fo_learning_deviation(a, s, FO_INVERTER, 2, l->inverter_voltage);
    for (int i = 0; i < FO_N; i++) {
        l->offset[i] = fo_learning_value(a, s, FO_OFFSET + i);
        l->offset_std[i] = fo_learning_deviation(a, s, FO_OFFSET + i, 1, ZERO);
        l->asymmetry[i] = ZERO;
        l->asymmetry_std[i] = ZERO;
        l->inductance_error[i] = fo_learning_value(a, s, FO_INDUCTANCE + i);
        l->inductance_std[i] = fo_learning_deviation(a, s, FO_INDUCTANCE + i, 1, ZERO);
#if FO_ASYMMETRIC
        l->asymmetry[i] = fo_learning_value(a, s, FO_ASYMMETRY + i);
        l->asymmetry_std[i] = fo_learning_deviation(a, s, FO_ASYMMETRY + i, 1, ZERO);
#endif
    }
}
