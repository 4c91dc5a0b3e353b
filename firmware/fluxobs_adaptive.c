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
/* Rated current as a multiple of the given current [1], by default. */
static const fo_real RATED = (fo_real)20;
/* Voltage error outside the model, relative to the drift's prior std [1]. This error limits how
 * long the filter trusts the voltage. */
static const fo_real UNMODELLED = (fo_real)0.1;

/* ---- configuration -------------------------------------------------------------------- */

static void prepare_adaptive(fo_adaptive *a, const fo_config *config, const fo_adaptive_config *c)
{
    const fo_real psi = config->flux_base;
    const fo_real through_L = (config->L_position + c->saliency) * config->current_noise / psi;
    const fo_real half = c->inverter_std / fo_sqrt(TWO);
    const fo_real stds[FO_NP] = {
        c->psi_f_std / psi, c->resistance_std, half, half, c->offset_std, c->offset_std,
#if FO_ASYMMETRIC
        c->asymmetry_std,   c->asymmetry_std,
#endif
        c->L_d_std,         c->L_q_std,
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
    fo_observer two;
    fo_scale_to_duration(&a->plain, TWO * config->sample_time, &two);
    a->guard_reinject = two.reinject;
    for (int i = 0; i < 3; i++) {
        a->guard_track[i] = two.track[i];
    }
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

/* ---- state ------------------------------------------------------------------------------ */

void fo_adaptive_reset(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s, 0, sizeof *s);
    fo_reset(&a->plain, &s->plain);
    fo_learning_reset(a, &s->learner);
    s->report = s->learner.report;
    s->emf_ratio = TWO;
    s->x[0] = ONE;
    s->place = true;
}

void fo_adaptive_restart(const fo_adaptive *a, fo_adaptive_state *s, bool frozen)
{
    fo_learner before;
    before = s->learner;
    fo_adaptive_reset(a, s);
    (void)memcpy(s->learner.U, before.U, sizeof before.U);
    (void)memcpy(s->learner.d, before.d, sizeof before.d);
    (void)memcpy(s->learner.z, before.z, sizeof before.z);
    (void)memcpy(s->learner.p, before.p, sizeof before.p);
    (void)memcpy(s->learner.means, before.means, sizeof before.means);
    (void)memcpy(s->learner.report.reported_std, before.report.reported_std,
                 sizeof before.report.reported_std);
    s->learner.report.loss_size = before.report.loss_size;
    s->learner.frozen = frozen;
    s->report = s->learner.report;
    fo_learning_values(a, &s->learner, s->value);
}

void fo_adaptive_learnt(const fo_adaptive *a, const fo_adaptive_state *s, fo_learnt *l)
{
    const fo_learner *r = &s->learner;
    const fo_real base = a->plain.flux_base;
    fo_real value[FO_NP], now[FO_PRIOR_MEANS];
    fo_learning_values(a, r, value);
    fo_learning_prior_means(a, now); /* they differ from the learner's just after a retuning */
    fo_learning_shift_values(r->means, now, value);
    l->psi_f = (a->psi + value[FO_PSI]) * base;
    l->psi_f_std = fo_learning_std(a, r, FO_PSI, 1) * base;
    l->resistance_error = value[FO_RESISTANCE];
    l->resistance_std = fo_learning_std(a, r, FO_RESISTANCE, 1);
    l->inverter_voltage = TWO * a->inverter_mean + value[FO_INVERTER] + value[FO_INVERTER + 1];
    l->inverter_std = fo_learning_std(a, r, FO_INVERTER, 2);
    for (int i = 0; i < FO_N; i++) {
        l->offset[i] = value[FO_OFFSET + i];
        l->offset_std[i] = fo_learning_std(a, r, FO_OFFSET + i, 1);
        l->asymmetry[i] = ZERO;
        l->asymmetry_std[i] = ZERO;
        l->inductance_error[i] = value[FO_INDUCTANCE + i];
        l->inductance_std[i] = fo_learning_std(a, r, FO_INDUCTANCE + i, 1);
#if FO_ASYMMETRIC
        l->asymmetry[i] = value[FO_ASYMMETRY + i];
        l->asymmetry_std[i] = fo_learning_std(a, r, FO_ASYMMETRY + i, 1);
#endif
    }
}

/* ---- interrupt and learner in one call ---------------------------------------------------- */

void fo_adaptive_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real voltage[FO_N],
                      const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    fo_adaptive_fast_step(a, s, voltage, current, e);
    (void)fo_adaptive_learn(a, s);
}

void fo_adaptive_step_volt_seconds(const fo_adaptive *a, fo_adaptive_state *s,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *e)
{
    fo_adaptive_fast_step_volt_seconds(a, s, volt_seconds, current, e);
    (void)fo_adaptive_learn(a, s);
}

void fo_adaptive_step_for(const fo_adaptive *a, fo_adaptive_state *s, fo_real duration,
                          const fo_real voltage[FO_N], const fo_real current[FO_N],
                          fo_adaptive_estimate *e)
{
    fo_adaptive_fast_step_for(a, s, duration, voltage, current, e);
    (void)fo_adaptive_learn(a, s);
}
