/* SPDX-License-Identifier: MIT */
#include "fluxobs_adaptive.h"

#include "fluxobs_internal.h"
#include "fluxobs_learning.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what determined their value ----------------------------- */

/* The inverter's loss is modelled by two soft signs. They saturate at these multiples of the given
 * current: two signs and a resistance fit any curve to within a few percent of the loss [1]. */
static const fo_real HARD = (fo_real)0.2;
static const fo_real SOFT = (fo_real)1.2;
/* Scale I of the curve, a considered parameter: i (1 - |i| / I). I is this multiple of the given
 * current, by default rated current [1]. */
static const fo_real RATED = (fo_real)20;
/* Std of the curve relative to the loss [1]. The curve is at most a quarter of it, which is 4 % of
 * the loss. */
static const fo_real CURVE_STD = (fo_real)0.15;
/* Voltage error outside the model, relative to the drift's prior std [1]. This error limits how
 * long the filter trusts the voltage. */
static const fo_real UNMODELLED = (fo_real)0.1;
/* Voltage error outside the model while a position is valid [1]: the residual does not show the
 * slow turn that this error causes. */
static const fo_real VOLTAGE_TURN = (fo_real)0.05;
/* Std of the angle above which the linearisation fails [rad]: 30 degrees. */
static const fo_real STD_LOST = PI / (fo_real)6;
/* Std of a valid angle, including errors of inductance and lag [rad]: 10 degrees. */
static const fo_real STD_ALL = PI / (fo_real)18;
/* Rows of the filter before its position may be valid [1]: half a turn. */
static const fo_real PROVEN_AFTER = (fo_real)4;
/* Rows of the filter before its std may stop it [1]: two turns. A start at a std of 20 degrees
 * weighs its first rows little, because the relation is not linear over 20 degrees. */
static const fo_real LOST_AFTER = (fo_real)16;
/* Samples in a row without a certain position after which the position must be confirmed again. */
static const uint32_t UNCERTAIN_AFTER = (uint32_t)FO_MAX_CONSECUTIVE_BAD;
/* A position is not valid if the power of its innovations exceeds this limit [1]: three stds. */
static const fo_real CONTRADICTION = (fo_real)9;
/* If the filter loses the position within this many rows (two turns), its parameters are reset
 * [1]. */
static const fo_real EARLY_ROWS = (fo_real)16;
/* The filter is wrong if the power of its innovations exceeds this limit [1]: ten stds. */
static const fo_real INNOVATION_POWER_MAX = (fo_real)100;
/* The filter is wrong if a parameter is this many stds from its prior [1]. */
static const fo_real PARAMETER_STDS_MAX = (fo_real)4;
/* The filter is wrong if its angle differs from the guard's by 20 degrees for a turn [rad, rad]. */
static const fo_real DISAGREEMENT = PI / (fo_real)9;
static const fo_real DISAGREEMENT_TURN = TWO * PI;


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
    a->delay_std = c->delay_std;
    a->current_gain_std = c->current_gain_std;
    a->iron_flux = config->L_position * c->iron_current_std / psi;
    a->magnet_error = c->harmonic_std * a->psi;
    a->through_L = through_L * through_L;
    a->unmodelled = UNMODELLED * a->plain.drift_prior_std;
    a->slow = config->memory / c->slow_memory;
    a->projection = c->projection;
}

static field_error check_adaptive(const fo_adaptive *a, const fo_adaptive_config *c)
{
    const fo_real high = (fo_real)1e9, million = (fo_real)1e6;
    field_error error = {FO_OK, NULL};
    demand_size(&error, a->saliency * a->plain.current_limit, -million, million, "saliency");
    demand_size(&error, a->over_current[0], (fo_real)1e-9, high, "inverter_current");
    demand_size(&error, a->through_L, ZERO, million, "saliency");
    demand_size(&error, c->slow_memory, ZERO, high, "slow_memory");
    demand_size(&error, c->lag_std, ZERO, high, "lag_std");
    demand_size(&error, c->delay_std, ZERO, high, "delay_std");
    demand_size(&error, a->current_gain_std, ZERO, high, "current_gain_std");
    demand_size(&error, a->iron_flux, ZERO, high, "iron_current_std");
    demand_size(&error, a->magnet_error, ZERO, high, "harmonic_std");
    demand_size(&error, c->inverter_voltage, ZERO, high, "inverter_voltage");
    demand_size(&error, a->psi, ZERO, (fo_real)1e3, "psi_f");
    demand_size(&error, a->std[FO_PSI], ZERO, high, "psi_f_std");
    demand_size(&error, a->std[FO_RESISTANCE], ZERO, high, "resistance_std");
    demand_size(&error, a->std[FO_INVERTER], ZERO, high, "inverter_std");
    demand_size(&error, a->std[FO_OFFSET], ZERO, high, "offset_std");
    demand_size(&error, a->std[FO_INDUCTANCE], ZERO, high, "L_d_std");
    demand_size(&error, a->std[FO_INDUCTANCE + 1], ZERO, high, "L_q_std");
#if FO_ASYMMETRIC
    demand_size(&error, a->std[FO_ASYMMETRY], ZERO, high, "asymmetry_std");
#endif
    return error;
}

static field_error prepare_adaptive_checked(fo_adaptive *a, const fo_config *config,
                                const fo_adaptive_config *c)
{
    field_error error = {fo_init(&a->plain, config), NULL};
    if (error.code != FO_OK) {
        error.field = fo_wrong(config);
    }
    demand(&error, c->inverter_current > ZERO, FO_ERROR_BASE, "inverter_current");
    demand(&error, c->slow_memory > ZERO, FO_ERROR_BASE, "slow_memory");
#if !FO_ASYMMETRIC
    demand(&error, !(c->asymmetry_std > ZERO), FO_ERROR_OTHER, "asymmetry_std");
#endif
    demand_size(&error, c->inverter_current, (fo_real)1e-9, (fo_real)1e9, "inverter_current");
    if (error.code == FO_OK) {
        prepare_adaptive(a, config, c);
        error = check_adaptive(a, c);
    }
    return error;
}

fo_error fo_adaptive_init(fo_adaptive *a, const fo_config *config, const fo_adaptive_config *c)
{
    return prepare_adaptive_checked(a, config, c).code;
}

const char *fo_adaptive_wrong(const fo_config *config, const fo_adaptive_config *c)
{
    fo_adaptive a;
    return prepare_adaptive_checked(&a, config, c).field;
}

void fo_adaptive_reset(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s, 0, sizeof *s);
    fo_reset(&a->plain, &s->plain);
    fo_learning_reset(a, s);
    s->x[0] = ONE;
    fo_candidates_place(a, s);
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
    (void)memcpy(s->reported_std, before.reported_std, sizeof s->reported_std);
    s->frozen = frozen;
    fo_candidates_place(a, s);
}

/* ---- the inverter --------------------------------------------------------------------- */

/* tanh(x) to within 0.0014 by its Pade approximant, clipped where the approximant reaches 1. */
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

/* Computes the amplitude-invariant vector of the soft signs of the phase currents. Adds the
 * vector's derivative by the current (alpha alpha, alpha beta, beta beta) times `volts` to
 * `gradient`. Returns the softness of the signs, 0 to 1. */
static fo_real soft_signs(const fo_real current[FO_N], fo_real over, fo_real volts,
                      fo_real signs[FO_N], fo_real gradient[3])
{
    const fo_real half = current[0] / TWO, root = (fo_real)0.8660254037844386 * current[1];
    const fo_real phases[3] = {soft_sign(current[0] * over), soft_sign((root - half) * over),
                               soft_sign((-root - half) * over)};
    fo_real slope[3];
    for (int i = 0; i < 3; i++) {
        slope[i] = volts * over * (ONE - phases[i] * phases[i]);
    }
    signs[0] = (TWO * phases[0] - phases[1] - phases[2]) / (fo_real)3;
    signs[1] = (phases[1] - phases[2]) * (fo_real)0.5773502691896258;
    gradient[0] += ((fo_real)4 * slope[0] + slope[1] + slope[2]) / (fo_real)6;
    gradient[1] += (slope[2] - slope[1]) * (fo_real)0.2886751345948129;
    gradient[2] += (slope[1] + slope[2]) / TWO;
    return ONE -
           (phases[0] * phases[0] + phases[1] * phases[1] + phases[2] * phases[2]) / (fo_real)3;
}

/* Estimated voltage of one part of the inverter's loss [V]. */
static fo_real inverter_loss_part(const fo_adaptive *a, const fo_adaptive_state *s, int n)
{
    return a->inverter_mean + fo_learning_value(a, s, FO_INVERTER + n);
}

/* Voltage lost in the interval that ends with this current, in addition to the assumed resistance's
 * drop. The estimates of resistance error and inverter loss determine it; the asymmetry is not
 * included. Stores the signs. */
static void predicted_loss(const fo_adaptive *a, fo_adaptive_state *s, const fo_real current[FO_N],
                       fo_real loss[FO_N])
{
    const fo_state *q = &s->plain;
    fo_real mean[FO_N], without_offset[FO_N];
    for (int i = 0; i < FO_N; i++) {
        mean[i] = current[i];
        if (q->have_current) {
            mean[i] = mean_current_24(current[i], q->current[0][i], q->current[1][i],
                                      q->current[2][i]) /
                      (fo_real)24;
        }
    }
    if (!(dot(mean, mean) <= a->plain.current_limit * a->plain.current_limit)) {
        mean[0] = q->current[0][0]; /* the current is not finite, or absurd */
        mean[1] = q->current[0][1];
    }
    for (int i = 0; i < FO_N; i++) {
        without_offset[i] = mean[i] - fo_learning_value(a, s, FO_OFFSET + i);
        loss[i] = fo_learning_value(a, s, FO_RESISTANCE) * mean[i];
    }
    (void)memset(s->sign_gradient, 0, sizeof s->sign_gradient);
    for (int n = 0; n < 2; n++) {
        const fo_real volts = inverter_loss_part(a, s, n);
        (void)soft_signs(without_offset, a->over_current[n], volts, s->signs[n], s->sign_gradient);
        for (int i = 0; i < FO_N; i++) {
            loss[i] += volts * s->signs[n][i];
        }
    }
    const fo_real apart[FO_N] = {s->signs[0][0] - s->signs[1][0], s->signs[0][1] - s->signs[1][1]};
    s->knee = fo_sqrt(dot(apart, apart));
}

/* u + g conj(u) */
static void correct_asymmetry(const fo_adaptive *a, const fo_adaptive_state *s,
                              const fo_real u[FO_N], fo_real corrected[FO_N]) {
    corrected[0] = u[0];
    corrected[1] = u[1];
#if FO_ASYMMETRIC
    const fo_real g0 = fo_learning_value(a, s, FO_ASYMMETRY);
    const fo_real g1 = fo_learning_value(a, s, FO_ASYMMETRY + 1);
    corrected[0] += g0 * u[0] + g1 * u[1];
    corrected[1] += g1 * u[0] - g0 * u[1];
#else
    (void)a;
    (void)s;
#endif
}

/* Volt-seconds of the last interval, and their change with one prior std of each parameter. */
static void integrate_with_sensitivities(const fo_adaptive *a, const fo_adaptive_state *s,
                                         bool complete, fo_interval *t) {
    const fo_real volts = inverter_loss_part(a, s, 0) + inverter_loss_part(a, s, 1);
    fo_real mean[FO_N], mean_24[FO_N], u[FO_N];
    for (int i = 0; i < FO_N; i++) {
        mean_24[i] = mean_current_24(s->plain.current[0][i], s->plain.current[1][i],
                                     s->plain.current[2][i], s->plain.current[3][i]);
        mean[i] = mean_24[i] / (fo_real)24;
    }
    const fo_real share = fo_sqrt(dot(mean, mean)) * a->over_rated;
    const fo_real *std = a->std, *gradient = s->sign_gradient;
    for (int i = 0; i < FO_N; i++) {
        const fo_real drop = row_of(a->plain.hR, i, mean_24);
        t->v[i] = s->plain.source[i] - (complete ? ZERO : drop);
        u[i] = s->plain.source[i] + (complete ? drop : ZERO);
        t->sensitivity[FO_PSI][i] = ZERO;
        t->sensitivity[FO_RESISTANCE][i] = -std[FO_RESISTANCE] * a->volt * mean[i];
        t->sensitivity[FO_INVERTER][i] = -std[FO_INVERTER] * a->volt * s->signs[0][i];
        t->sensitivity[FO_INVERTER + 1][i] = -std[FO_INVERTER + 1] * a->volt * s->signs[1][i];
        t->sensitivity[FO_OFFSET][i] = std[FO_OFFSET] * a->volt * gradient[i];
        t->sensitivity[FO_OFFSET + 1][i] = std[FO_OFFSET + 1] * a->volt * gradient[1 + i];
        t->sensitivity[FO_INDUCTANCE][i] = ZERO;
        t->sensitivity[FO_INDUCTANCE + 1][i] = ZERO;
        t->sensitivity[FO_CURVE][i] =
            -std[FO_CURVE] * a->volt * volts * mean[i] * a->over_rated * (ONE - share);
    }
#if FO_ASYMMETRIC
    t->sensitivity[FO_ASYMMETRY][0] = std[FO_ASYMMETRY] * u[0];
    t->sensitivity[FO_ASYMMETRY][1] = -std[FO_ASYMMETRY] * u[1];
    t->sensitivity[FO_ASYMMETRY + 1][0] = std[FO_ASYMMETRY + 1] * u[1];
    t->sensitivity[FO_ASYMMETRY + 1][1] = std[FO_ASYMMETRY + 1] * u[0];
#else
    (void)u;
#endif
}

/* ---- the filter, guarded -------------------------------------------------------------- */

/* Stops the filter and places new candidates. The parameters keep their estimates unless the filter
 * was wrong. */
static void stop_filter(const fo_adaptive *a, fo_adaptive_state *s, bool wrong)
{
    if (wrong) {
        s->restarts++;
    }
    if (wrong && !s->frozen) {
        fo_learning_reset(a, s);
    }
    fo_candidates_place(a, s);
}

/* Std of an angle with this variance: at most the std of an unknown angle. */
static fo_real capped_std(fo_real variance)
{
    return fo_sqrt(variance < VARIANCE_UNKNOWN ? variance : VARIANCE_UNKNOWN);
}

/* Writes the parameters into the estimate. */
static void write_parameters(const fo_adaptive *a, const fo_adaptive_state *s,
                              fo_adaptive_estimate *e)
{
    e->psi_f_std = s->reported_std[0] * a->plain.flux_base;
    e->resistance_error = fo_learning_value(a, s, FO_RESISTANCE);
    e->resistance_std = s->reported_std[1];
    e->inverter_voltage = inverter_loss_part(a, s, 0) + inverter_loss_part(a, s, 1);
    e->inverter_std = s->reported_std[2];
}

/* Why the filter's position is not valid. `all` is the variance of its angle, `variance` the part
 * that measurements reduce. */
static fo_reason judge_filter(const fo_adaptive_state *s, fo_real variance, fo_real all)
{
    fo_reason reason = FO_VALID;
    if (!(s->tracker.settled >= TRACKER_SETTLED)) {
        reason = FO_SETTLING;
    } else if (!(s->emf_ratio < EMF_RATIO_LIMIT)) {
        reason = FO_SLOW;
    } else if (!(s->innovation_power < CONTRADICTION)) {
        reason = FO_CONTRADICTED;
    } else if (!(variance < STD_LIMIT * STD_LIMIT && all < STD_ALL * STD_ALL)) {
        reason = FO_UNCERTAIN;
    } else {
        /* valid */
    }
    return reason;
}

/* Writes the filter's estimate, with this length of the position vector and this variance of the
 * angle. `fixed` is the variance due to errors that measurements do not reduce: of L_q and of the
 * considered parameters. */
static void write_filter_estimate(const fo_adaptive *a, const fo_adaptive_state *s, fo_real length,
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
    q->theta_e_std = capped_std(all);
    q->noise_share = ZERO;
    set_reason(q, judge_filter(s, variance, all));
    e->psi_f = (a->psi + fo_learning_value(a, s, FO_PSI)) * o->flux_base;
#if FO_MAPPED
    if (has_cage_map(o)) {
        e->psi_f += s->plain.map_point.active_flux * o->flux_base;
    }
#endif
    const fo_real gain = fo_sqrt(s->d[FO_N]) * o->drift_prior_std; /* prior std over std */
    e->drift_std = o->drift_prior_std * o->drift_base / (gain > ONE ? gain : ONE);
    e->theta_other = q->theta_e;
    e->weight_other = ZERO;
}

/* Are all numbers of an estimate finite? */
static bool is_finite_estimate(const fo_adaptive_estimate *e)
{
    const fo_estimate *q = &e->position;
    const fo_real sum = q->flux[0] + q->flux[1] + q->drift[0] + q->drift[1] + q->psi_f +
                        q->theta_e + q->speed_e + q->theta_e_std + e->psi_f + e->psi_f_std +
                        e->drift_std + e->resistance_error + e->resistance_std +
                        e->inverter_voltage + e->inverter_std;
    return sum - sum == ZERO;
}

/* Writes the plain observer's position. The plain observer's std does not include the parameters,
 * so their part is added. */
static void use_plain_estimate(const fo_adaptive_state *s, const fo_estimate *plain,
                        fo_adaptive_estimate *e)
{
    fo_estimate *q = &e->position;
    *q = *plain;
    q->theta_e_std =
        capped_std(plain->theta_e_std * plain->theta_e_std + s->emf_ratio * s->emf_ratio);
    if (q->valid && !(q->theta_e_std < STD_LIMIT)) {
        set_reason(q, FO_UNCERTAIN);
    }
}

/* Variance of the angle due to considered parameters that leave no residual at constant speed and
 * load: lags of voltages and currents, unequal gains of the current sensors, iron loss, harmonics
 * of the magnet flux. `square` is that of the position vector. */
static fo_real considered_variance(const fo_adaptive *a, const fo_adaptive_state *s, fo_real square)
{
    const fo_observer *o = &a->plain;
    const fo_real *current = s->plain.current[0];
    const fo_real speed = s->tracker.speed, late = a->lag_std * speed, delay = a->delay_std * speed;
    const fo_real armature = o->L_position * o->L_position * dot(current, current);
    const fo_real fluxes = armature * (delay * delay + a->current_gain_std * a->current_gain_std) +
                           a->iron_flux * a->iron_flux + a->magnet_error * a->magnet_error;
    return late * late + fluxes / square + cage_ripple_variance(o, speed);
}

/* Writes the estimate after a step of the filter. Returns the variance of its angle without errors
 * of inductance and lag. */
static fo_real report_step(const fo_adaptive *a, fo_adaptive_state *s, fo_real length,
                           fo_real step, fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    const fo_real square = length * length;
    const fo_real inverter = fo_learning_unmodelled_voltage(a, s) * o->h;
    const fo_real other = VOLTAGE_TURN * o->drift_prior_std * o->h;
    s->voltage_turn += (other + inverter) / length - s->voltage_turn * step;
    const fo_real noise = o->position_noise * s->plain.noise_inflation;
    const fo_real variance =
        (s->variance_across + fo_learning_variance_growth(a, s) + noise) / square +
        s->voltage_turn * s->voltage_turn / (fo_real)3; /* the turn is a bound: a uniform error */
    settle_tracker(o, &s->tracker, s->theta, fo_sqrt(variance));
    write_filter_estimate(
        a, s, length, variance,
        s->variance_by_L_q_now / square + considered_variance(a, s, square),
        e);
    return variance;
}

/* Does the filter contradict its guard, its model or its prior? */
static bool is_wrong(const fo_adaptive_state *s)
{
    return s->disagreement > DISAGREEMENT_TURN || s->innovation_power > INNOVATION_POWER_MAX ||
           fo_abs(s->p[FO_RESISTANCE]) > PARAMETER_STDS_MAX ||
           fo_abs(s->p[FO_INDUCTANCE]) > PARAMETER_STDS_MAX ||
           fo_abs(s->p[FO_INDUCTANCE + 1]) > PARAMETER_STDS_MAX;
}

/* Processes a sample while the filter runs. `e` holds the estimate of the plain observer, the
 * filter's guard. */
static void run_filter(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                       bool measured, fo_adaptive_estimate *e)
{
    fo_adaptive_estimate plain;
    plain = *e;
    const fo_real length = fo_learning_step(a, s, t, measured);
    if (length * length > ZERO) {
        const fo_real turned = fo_abs(s->tracker.speed) * a->plain.sample_time;
        const fo_real step = turned < ONE ? turned : ONE;
        track(&a->plain, &s->tracker, s->theta);
        fo_learning_update_emf_ratio(a, s, t, length, turned);
        const fo_real variance = report_step(a, s, length, step, e);
        const bool guarded = plain.position.valid;
        const bool differs =
            guarded && fo_abs(wrap(s->theta - plain.position.theta_e)) > DISAGREEMENT;
        s->disagreement = differs ? s->disagreement + step : guarded ? ZERO : s->disagreement;
        write_parameters(a, s, e);
        const bool is_finite = is_finite_estimate(e);
        if (!is_finite) {
            *e = plain;
        } else if (guarded && !(s->rows > PROVEN_AFTER)) {
            use_plain_estimate(s, &plain.position, e);
        } else {
            /* report the filter's own position */
        }
        const bool wrong = !is_finite || is_wrong(s);
        const bool lost = s->emf_ratio > ONE ||
                          (s->rows > LOST_AFTER && !(variance < STD_LOST * STD_LOST));
        const bool early = lost && s->rows < EARLY_ROWS &&
                           s->reported_std[1] > a->std[FO_RESISTANCE] / TWO;
        if (wrong || lost) {
            stop_filter(a, s, wrong || early);
        }
    } else {
        stop_filter(a, s, true);
    }
}

/* ---- the start ------------------------------------------------------------------------ */

/* Writes the best candidate's position. The variance includes the weight of the second best
 * candidate. */
static void write_candidate(const fo_adaptive *a, const fo_adaptive_state *s,
                            const fo_choice *choice, fo_estimate *q)
{
    const fo_candidate *best = &choice->best;
    const fo_real apart = wrap(choice->second_theta - best->theta);
    const fo_real variance = best->variance + choice->second_weight * apart * apart;
    q->theta_e = best->theta;
    q->theta_e_tracked = s->tracker.angle;
    q->speed_e = s->tracker.speed;
    q->theta_e_std = capped_std(variance);
    for (int i = 0; i < FO_N; i++) {
        q->flux[i] = best->p[i] * a->plain.flux_base;
        q->drift[i] = best->p[FO_N + i] * a->plain.drift_base;
    }
    q->psi_f = fo_sqrt(best->p[2 * FO_N]) * a->plain.flux_base;
    set_reason(q, FO_SEARCHING);
}

/* Fits the candidates. Starts the filter at the best candidate once the choice is decided and the
 * rotor has turned far enough. */
static void start_from_candidates(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                                  fo_adaptive_estimate *e)
{
    fo_estimate *q = &e->position;
    fo_choice choice;
    fo_candidates_step(a, s, t->v, &choice);
    const bool likely = choice.has_best && choice.second_weight < ONE / TWO;
    e->weight_other = choice.second_weight;
    if (likely) {
        e->theta_other = choice.second_theta;
    }
    s->seeded = s->seeded && !s->plain.trusted && q->theta_e_std < capped_std(VARIANCE_UNKNOWN);
    if (s->plain.trusted) {
        fo_estimate plain;
        plain = *q;
        use_plain_estimate(s, &plain, e);
    } else if (choice.has_best && !s->seeded) {
        write_candidate(a, s, &choice, q);
    } else {
        /* the estimate is still that of the plain observer */
    }
    s->rotation = likely ? s->rotation + wrap(choice.best.theta - s->theta) : ZERO;
    s->theta = choice.has_best ? choice.best.theta : s->theta;
    if (choice.decided && s->emf_ratio < EMF_RATIO_LIMIT && fo_abs(s->rotation) > SWEEP) {
        fo_learning_start(a, s, &choice.best, &choice.information, choice.inflation, t);
    }
}

/* Starts the filter from the plain observer's solution. */
static void start_from_plain(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t)
{
    fo_manifold information;
    fo_candidate c;
    c = s->now.start.candidates[0];
    const fo_real power = s->plain.power;
    for (int i = 0; i < FO_N; i++) {
        c.p[i] = s->plain.x[FLUX + i];
        c.p[FO_N + i] = s->plain.x[DRIFT + i];
    }
    s->tracker = s->plain.tracker;
    fo_gauss_newton_step(a, s, &c, &information);
    if (c.variance < STD_LOST * STD_LOST) {
        fo_learning_start(a, s, &c, &information, power > ONE ? power : ONE, t);
    }
}

/* Processes a sample before the filter runs. */
static void run_start(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                      fo_adaptive_estimate *e)
{
    const fo_real turned =
        s->plain.trusted ? fo_abs(s->plain.tracker.speed) * a->plain.sample_time : ZERO;
    fo_learning_update_emf_ratio(a, s, t, s->plain.length, turned);
    if (a->projection != FO_PROJECT_NEVER) {
        start_from_candidates(a, s, t, e);
    } else if (s->plain.trusted && s->emf_ratio < EMF_RATIO_LIMIT) {
        start_from_plain(a, s, t);
    } else {
        /* wait for the plain observer */
    }
}

/* A position that has become certain is valid once the rotor has turned by half a turn: the length
 * of the position vector shows a wrong flux within that rotation. A position that jumps must be
 * confirmed again. */
static void confirm(const fo_adaptive *a, fo_adaptive_state *s, fo_estimate *q)
{
    const bool certain = q->valid && follows(&s->tracker, q->theta_e, q->theta_e_std);
    s->uncertain = certain ? 0U : s->uncertain + 1U;
    if (s->uncertain > UNCERTAIN_AFTER) {
        s->confirmed = ZERO;
    } else {
        s->confirmed += fo_abs(s->tracker.speed) * a->plain.sample_time;
    }
    if (q->valid && !(s->confirmed > SWEEP)) {
        set_reason(q, FO_UNCONFIRMED);
    }
}

/* ---- samples -------------------------------------------------------------------------- */

typedef struct {
    uint32_t voltages, currents;
} bad_samples;

static bad_samples count_bad_samples(const fo_state *q)
{
    const bad_samples count = {q->bad_voltages, q->bad_currents + q->outliers};
    return count;
}

/* The work of a sample after the plain observer's step. */
static void finish_sample(const fo_adaptive *a, fo_adaptive_state *s, bool complete,
                          bad_samples before, fo_adaptive_estimate *e) {
    const bad_samples now = count_bad_samples(&s->plain);
    const bool measured = now.currents == before.currents;
    e->theta_other = e->position.theta_e;
    e->weight_other = e->position.valid ? ZERO : ONE / TWO;
    e->psi_f = e->position.psi_f;
    e->drift_std = a->plain.drift_prior_std * a->plain.drift_base;
    if (s->plain.have_current && s->plain.have_voltage) {
        fo_interval t;
        integrate_with_sensitivities(a, s, complete, &t);
        e->adapting = s->running;
        if (s->running) {
            run_filter(a, s, &t, measured, e);
        } else {
            run_start(a, s, &t, e);
        }
    } else {
        e->adapting = false;
        if (!s->plain.have_current && s->running) {
            stop_filter(a, s, false);
        }
        s->emf_ratio = TWO;
    }
    s->sample_index++;
    if (!e->adapting || !s->running) { /* otherwise run_filter has written them */
        write_parameters(a, s, e);
    }
    confirm(a, s, &e->position);
    if (e->position.valid && !(measured && now.voltages == before.voltages)) {
        set_reason(&e->position, FO_BAD_SAMPLE);
    }
}

/* Chooses the angle at which the plain observer linearises the map. The filter's angle is used if
 * the filter runs and the plain observer has no position. Otherwise the plain observer uses its own
 * angle, since a guard must not depend on the filter that it guards. */
static void set_map_angle(const fo_adaptive *a, fo_adaptive_state *s)
{
#if FO_MAPPED
    s->plain.has_external_angle = s->running && !s->plain.trusted;
    s->plain.external_angle = predicted_angle(&a->plain, &s->tracker);
#else
    (void)a;
    (void)s;
#endif
}

static void reset_if_damaged(const fo_adaptive *a, fo_adaptive_state *s)
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
    reset_if_damaged(a, s);
    const bad_samples before = count_bad_samples(&s->plain);
    fo_real loss[FO_N], corrected[FO_N];
    predicted_loss(a, s, current, loss);
    correct_asymmetry(a, s, voltage, corrected);
    for (int i = 0; i < FO_N; i++) {
        corrected[i] -= loss[i];
    }
    set_map_angle(a, s);
    fo_step(&a->plain, &s->plain, corrected, current, &e->position);
    finish_sample(a, s, false, before, e);
}

void fo_adaptive_step_volt_seconds(const fo_adaptive *a, fo_adaptive_state *s,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *e)
{
    reset_if_damaged(a, s);
    const bad_samples before = count_bad_samples(&s->plain);
    fo_real loss[FO_N], corrected[FO_N];
    predicted_loss(a, s, current, loss);
    correct_asymmetry(a, s, volt_seconds, corrected);
    for (int i = 0; i < FO_N; i++) {
        corrected[i] -= a->plain.sample_time * loss[i];
    }
    set_map_angle(a, s);
    fo_step_volt_seconds(&a->plain, &s->plain, corrected, current, &e->position);
    finish_sample(a, s, true, before, e);
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
    l->psi_f_std = fo_learning_std(a, s, FO_PSI, 1, ZERO) * base;
    l->resistance_error = fo_learning_value(a, s, FO_RESISTANCE);
    l->resistance_std = fo_learning_std(a, s, FO_RESISTANCE, 1, ZERO);
    l->inverter_voltage = inverter_loss_part(a, s, 0) + inverter_loss_part(a, s, 1);
    l->inverter_std = fo_learning_std(a, s, FO_INVERTER, 2, l->inverter_voltage);
    for (int i = 0; i < FO_N; i++) {
        l->offset[i] = fo_learning_value(a, s, FO_OFFSET + i);
        l->offset_std[i] = fo_learning_std(a, s, FO_OFFSET + i, 1, ZERO);
        l->asymmetry[i] = ZERO;
        l->asymmetry_std[i] = ZERO;
        l->inductance_error[i] = fo_learning_value(a, s, FO_INDUCTANCE + i);
        l->inductance_std[i] = fo_learning_std(a, s, FO_INDUCTANCE + i, 1, ZERO);
#if FO_ASYMMETRIC
        l->asymmetry[i] = fo_learning_value(a, s, FO_ASYMMETRY + i);
        l->asymmetry_std[i] = fo_learning_std(a, s, FO_ASYMMETRY + i, 1, ZERO);
#endif
    }
}
