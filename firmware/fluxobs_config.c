/* SPDX-License-Identifier: MIT */
#include "fluxobs_config.h"

#include "fluxobs_internal.h"

#include <string.h>

#define DECLARED(name, value) fo_real name;
#define DEFINED(name, value) (fo_real)(value),
static const struct {
    FO_USUAL(DECLARED)
} usual = {FO_USUAL(DEFINED)};

static fo_real larger(fo_real a, fo_real b) { return a > b ? a : b; }
static fo_real smaller(fo_real a, fo_real b) { return a < b ? a : b; }

/* ---- settings --------------------------------------------------------------------------- */

/* Current noise enters the flux directly, as L i. It also enters through the resistive drop, as a
 * random walk whose size is R sqrt(h T) / (2 L) of the direct noise. Where L/R is short, a shorter
 * memory keeps the random walk below the direct noise. But the memory must hold a turn at a quarter
 * of the speed. */
static fo_real memory_for(const fo_sizes *m, fo_real h)
{
    fo_real memory = m->usual_memory;
    if (m->speed_e > ZERO) {
        const fo_real constant = m->inductance / m->resistance;
        const fo_real quiet = usual.WALK * (constant * constant) / h;
        const fo_real least = larger((fo_real)10 * h, TWO * PI * usual.SLOW / m->speed_e);
        memory = smaller(memory, larger(quiet, least));
    }
    return memory;
}

/* 1 - exp(-x), x >= 0: computes the series for small x, then doubles x by 1 - exp(-2 x) = y (2 -
 * y). */
static fo_real one_minus_exp(fo_real x)
{
    const fo_real all = (fo_real)40; /* above this, exp(-x) is negligible */
    fo_real part = x < all ? x : all;
    int halvings = 0;
    for (int n = 0; n < 12; n++) {
        if (part > (fo_real)0.25) {
            part /= TWO;
            halvings++;
        }
    }
    fo_real y = ZERO;
    for (int n = 12; n > 0; n--) {
        y = part / (fo_real)n * (ONE - y);
    }
    for (; halvings > 0; halvings--) {
        y *= TWO - y;
    }
    return y;
}

void fo_kink_weights(fo_real share, fo_real weights[2])
{
    const fo_real ramp = (fo_real)0.01, a = share;
    if (a < ramp) { /* the response is a ramp */
        weights[0] = a / (fo_real)8;
        weights[1] = -a / (fo_real)24;
    } else {
        /* A step of the voltage adds (1 - exp(-t R/L)) / R to the current. Compute the mean of this
         * over the interval, minus the mean of the cubic through the samples. */
        const fo_real one = one_minus_exp(a), two = one_minus_exp(TWO * a);
        weights[0] = (a - one) / a - (fo_real)9 / (fo_real)24 * one;
        weights[1] = (a - (ONE - one) * one) / a -
                     ((fo_real)9 * two + (fo_real)19 * one) / (fo_real)24;
    }
}

void fo_choose(fo_config *c, const fo_sizes *m, fo_voltage voltage)
{
    const fo_real h = c->sample_time, flux = m->flux, square = flux * flux;
    const fo_real share = m->resistance * h / m->inductance;
    const bool held =
        voltage == FO_VOLTAGE_HELD || (voltage == FO_VOLTAGE_AUTO && share >= usual.MATTERS);
    fo_real kinks[2];
    /* The tracker's bandwidth must follow load steps, whatever the reason for a short memory. */
    c->tracker_bandwidth = usual.TRACKER / (c->memory > ZERO ? c->memory : m->usual_memory);
    c->memory = c->memory > ZERO ? c->memory : memory_for(m, h);
    c->current_noise =
        c->current_noise > ZERO ? c->current_noise : usual.CURRENT_NOISE * m->rated_current;
    if (!(c->drift_prior > ZERO)) {
        c->drift_prior = larger(usual.DRIFT_DROP * m->resistance * m->rated_current,
                                usual.DRIFT_TURN * flux / c->memory);
    }
    const fo_real noise = m->slope * c->current_noise, model = usual.MODEL_ERROR * square;
    fo_kink_weights(held ? share : ZERO, kinks);
    c->flux_base = flux;
    c->constraint_base = square;
    c->constraint_noise = fo_sqrt(noise * noise + model * model);
    c->current_limit =
        larger(usual.CURRENT_LIMIT * m->rated_current, usual.CURRENT_FLUX * flux / m->L_position);
    c->kink_now = kinks[0];
    c->kink_before = kinks[1];
    c->length_min = m->shortest * flux;
}

/* ---- machines --------------------------------------------------------------------------- */

static fo_machine machine(fo_kind kind, fo_real R_s, fo_real L_d, fo_real L_q, fo_real psi,
                          fo_real rated_current)
{
    const fo_machine m = {kind, R_s, L_d, L_q, psi, ZERO, ZERO, rated_current, ZERO};
    return m;
}

fo_machine fo_pmsm(fo_real R_s, fo_real L_s, fo_real psi_f, fo_real rated_current)
{
    return machine(FO_MAGNETS, R_s, L_s, L_s, psi_f, rated_current);
}

fo_machine fo_ipmsm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real psi_f, fo_real rated_current)
{
    return machine(FO_MAGNETS, R_s, L_d, L_q, psi_f, rated_current);
}

fo_machine fo_synrm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real rated_current)
{
    return machine(FO_RELUCTANCE, R_s, L_d, L_q, ZERO, rated_current);
}

fo_machine fo_induction(fo_real R_s, fo_real R_R, fo_real L_sigma, fo_real L_M, fo_real psi_R,
                        fo_real rated_current)
{
    fo_machine m = machine(FO_CAGE, R_s, L_sigma, L_sigma, psi_R, rated_current);
    m.psi = psi_R > ZERO ? psi_R : usual.MAGNETIZING * L_M * rated_current;
    m.R_R = R_R;
    m.L_M = L_M;
    return m;
}

static void set_sizes(const fo_machine *m, fo_sizes *s)
{
    const bool salient = m->kind == FO_RELUCTANCE; /* without magnets */
    s->resistance = m->R_s;
    s->inductance = TWO / (ONE / m->L_d + ONE / m->L_q);
    s->L_position = m->L_q;
    s->flux = salient ? usual.RELUCTANCE * m->L_d * m->rated_current : m->psi;
    s->slope = (salient ? m->L_d - m->L_q : TWO * m->L_q) * s->flux;
    s->shortest = salient ? usual.SHORTEST_SALIENT : usual.SHORTEST;
    s->rated_current = m->rated_current;
    s->usual_memory = usual.MEMORY;
    s->speed_e = m->speed_e;
}

/* ---- implausible numbers ------------------------------------------------------------------ */

static bool positive(fo_real x) { return x > ZERO && x - x == ZERO; }
static fo_real ratio_above_one(fo_real ratio) { return ratio > ONE ? ratio : ONE / ratio; }

/* Checks that each number is possible for its symbol. */
static void demand_possible(field_error *error, const fo_machine *m, fo_real sample_time)
{
    const bool has_cage = m->kind == FO_CAGE, salient = m->kind == FO_RELUCTANCE;
    const bool known = has_cage || salient || m->kind == FO_MAGNETS;
    demand(error, known, FO_ERROR_OTHER, "kind");
    demand(error, positive(m->R_s), FO_ERROR_BASE, "R_s");
    demand(error, positive(m->L_d), FO_ERROR_BASE, "L_d");
    demand(error, positive(m->L_q), FO_ERROR_BASE, "L_q");
    demand(error, salient || positive(m->psi), FO_ERROR_BASE, "psi");
    demand(error, !has_cage || positive(m->R_R), FO_ERROR_BASE, "R_R");
    demand(error, !has_cage || positive(m->L_M), FO_ERROR_BASE, "L_M");
    demand(error, positive(m->rated_current), FO_ERROR_BASE, "rated_current");
    demand(error, m->speed_e >= ZERO && m->speed_e - m->speed_e == ZERO, FO_ERROR_BASE, "speed_e");
    demand(error, !salient || m->L_d > m->L_q, FO_ERROR_RANGE, "L_d");
    demand(error, memory_fits(usual.MEMORY, sample_time), FO_ERROR_SAMPLE_TIME, "sample_time");
}

/* Limits for motors from grams to megawatts: L/R [s], L i / psi, and R i / psi [rad/s]. The last
 * ratio is the speed at which the EMF equals the rated resistive drop. The usual value is in the
 * middle of each list. */
static const fo_real TIME_CONSTANT[3] = {(fo_real)2e-6, (fo_real)3e-3, (fo_real)5};
static const fo_real LOAD_FLUX[3] = {(fo_real)1e-3, (fo_real)0.3, (fo_real)50};
static const fo_real DROP_SPEED[3] = {(fo_real)0.01, (fo_real)100, (fo_real)2e4};
/* Limits of L_d / L_q and its inverse, of L_M / L_sigma, and of L_M / R_R [s]. */
static const fo_real RATIO = (fo_real)50, MAGNETIZING_RATIO = (fo_real)1000;
static const fo_real ROTOR_CONSTANT[2] = {(fo_real)1e-3, (fo_real)100};

/* Where a ratio is beyond its limits, returns the number whose unit is most likely wrong. A wrong R
 * changes the first and the last of the three ratios, a wrong L the first two, a wrong psi or
 * current the last two. The wrong number is therefore the one whose unaffected ratio is nearest to
 * its usual value. */
static const char *likeliest_unit_error(const fo_machine *m, fo_real time, fo_real flux,
                                        fo_real speed) {
    const fo_real resistance = ratio_above_one(flux / LOAD_FLUX[1]);
    const fo_real inductance = ratio_above_one(speed / DROP_SPEED[1]);
    const fo_real scale = ratio_above_one(time / TIME_CONSTANT[1]);
    const char *wrong = inductance <= scale ? "L_q" : "psi or rated_current";
    if (m->kind == FO_RELUCTANCE) { /* the flux of this machine is L i */
        wrong = "R_s or L_d and L_q";
    } else if (resistance <= inductance && resistance <= scale) {
        wrong = "R_s";
    } else {
        /* either L or the scale is wrong */
    }
    return wrong;
}

/* Checks that the sizes fit each other. */
static void demand_fit(field_error *error, const fo_machine *m, const fo_sizes *s)
{
    const fo_real time = m->L_q / m->R_s, flux = m->L_q * m->rated_current / s->flux;
    const fo_real speed = m->R_s * m->rated_current / s->flux;
    if (m->kind == FO_CAGE) {
        const bool ratio = within(m->L_M / m->L_q, ONE, MAGNETIZING_RATIO);
        const bool constant = within(m->L_M / m->R_R, ROTOR_CONSTANT[0], ROTOR_CONSTANT[1]);
        demand(error, constant, FO_ERROR_RANGE, ratio ? "R_R" : "L_M");
    }
    demand(error,
           within(time, TIME_CONSTANT[0], TIME_CONSTANT[2]) &&
               within(flux, LOAD_FLUX[0], LOAD_FLUX[2]) &&
               within(speed, DROP_SPEED[0], DROP_SPEED[2]),
           FO_ERROR_RANGE, likeliest_unit_error(m, time, flux, speed));
    demand_size(error, m->L_d / m->L_q, ONE / RATIO, RATIO, "L_d");
}

static void configure(fo_config *c, const fo_machine *m, const fo_sizes *sizes)
{
    /* (flux - L_q i)'(flux - L i) is constant: L is L_q too, or L_d if there are no magnets. */
    const fo_real L = m->kind == FO_RELUCTANCE ? m->L_d : m->L_q;
    for (int i = 0; i < FO_N; i++) {
        c->Q1[i][i] = ONE;
        c->Q2[i][i] = -(L + m->L_q);
        c->Q3[i][i] = L * m->L_q;
        c->R[i][i] = m->R_s;
        c->B[i][i] = ONE;
    }
    c->L_position = m->L_q;
    fo_choose(c, sizes, FO_VOLTAGE_AUTO);
}

const char *fo_configure(fo_config *c, const fo_machine *m, fo_real sample_time)
{
    field_error error = {FO_OK, NULL};
    (void)memset(c, 0, sizeof *c);
    demand_possible(&error, m, sample_time);
    if (error.code == FO_OK) { /* after an error, ratios have no meaning */
        fo_sizes sizes;
        set_sizes(m, &sizes);
        demand_fit(&error, m, &sizes);
        if (error.code == FO_OK) {
            c->sample_time = sample_time;
            configure(c, m, &sizes);
        }
    }
    return error.field;
}

#if FO_MAPPED
bool fo_map_of(fo_map *map, const fo_machine *m, fo_real sample_time)
{
    const bool salient = m->kind == FO_MAGNETS && (m->L_d < m->L_q || m->L_d > m->L_q);
    (void)memset(map, 0, sizeof *map);
    map->kind = m->kind == FO_CAGE ? FO_MAP_CAGE : FO_MAP_LINEAR;
    map->magnets = true;
    map->L_d = m->L_d;
    map->L_q = m->L_q;
    if (m->kind == FO_CAGE) {
        map->decay = m->R_R * sample_time / m->L_M;
        map->still = usual.STILL * m->psi / m->L_M;
        map->ripple = m->R_R * (usual.CAGE_OFFSET * m->rated_current) / m->psi;
    } else {
        map->psi = m->psi;
    }
    return salient || m->kind == FO_CAGE;
}
#endif

#if FO_ADAPTIVE
void fo_adaptive_choose(fo_adaptive_config *a, const fo_machine *m, fo_real sample_time,
                        fo_real dc_link, uint32_t learn)
{
    const bool resistance = (learn & (uint32_t)FO_LEARN_RESISTANCE) != 0U;
    const bool inverter = (learn & (uint32_t)FO_LEARN_INVERTER) != 0U;
    const bool asymmetry = (learn & (uint32_t)FO_LEARN_ASYMMETRY) != 0U;
    const fo_real drop = usual.INVERTER_SHARE * m->R_s * m->rated_current;
    const fo_real psi = m->kind == FO_RELUCTANCE ? ZERO : m->psi;
    a->saliency = m->L_d - m->L_q;
    a->L_d_std = usual.INDUCTANCE_SHARE;
    a->L_q_std = usual.INDUCTANCE_SHARE;
    a->lag_std = usual.LAG_STD * sample_time;
    a->delay_std = usual.DELAY_STD * sample_time;
    a->current_gain_std = usual.CURRENT_GAIN_STD;
    a->iron_current_std = usual.IRON_SHARE * m->rated_current;
    a->harmonic_std = usual.HARMONIC_STD;
    a->psi_f = psi;
    a->psi_f_std = usual.PSI_SHARE * psi;
    a->resistance_std = resistance ? usual.RESISTANCE_SHARE * m->R_s : ZERO;
    a->inverter_voltage = ZERO;
    a->inverter_std = inverter ? larger(drop, usual.DC_LINK_SHARE * dc_link) : ZERO;
    a->inverter_current = usual.SMOOTHING * m->rated_current;
    a->offset_std = usual.OFFSET_SHARE * m->rated_current;
    a->asymmetry_std = asymmetry ? usual.ASYMMETRY_STD : ZERO;
    a->slow_memory = usual.SLOW_MEMORY;
    a->projection = FO_PROJECT_START;
}
#endif
