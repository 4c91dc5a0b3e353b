/* SPDX-License-Identifier: MIT */
#include "fluxobs_inject.h"

#if FO_ADAPTIVE

#include "fluxobs_internal.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what determined their value ----------------------------- */

/* Smallest saliency |1 - L_q / L_d| [1]: below it, cross-saturation turns the axis by more than an
 * angle that the observer can start from. */
static const fo_real SALIENCY_MIN = (fo_real)0.02;
/* Std of the axis from which the polarity is tested and the observer starts [rad]: two degrees. */
static const fo_real AXIS_STD = PI / (fo_real)90;
/* Std of the axis by cross-saturation and by the inverter, part of the seed's [rad]: two degrees. */
static const fo_real AXIS_TILT = PI / (fo_real)90;
/* The voltage of the search has six directions, 30 degrees apart, each for four samples: with their
 * mean, neither the inverter's loss nor a resistance turns the axis. */
static const uint32_t DIRECTION_SAMPLES = 4U, DIRECTIONS = 6U;
/* Part of the bias that the current must reach before a test of polarity measures [1]. */
static const fo_real BIAS_REACHED = (fo_real)0.9;
/* Measured samples of half a test, samples after which it measures in any case, and tests after
 * which the polarity stays open. */
static const uint32_t TEST_SAMPLES = 32U, TEST_DELAY = 400U, TESTS = 4U;
/* Least squared volt-seconds of half a test, as a share of those that tell the axis [1]: with fewer
 * the noise is too large to decide. */
static const fo_real EXCITATION_MIN = (fo_real)1e-3;
/* Stds of the difference of two responses above which the polarity is decided [1]: wrong once in
 * 30 000 starts. */
static const fo_real DECIDED = (fo_real)4;
/* Least difference, as a share of the response [1]: dead time and a current that still settles make
 * up to 1 % (tests/firmware/test_from_rest.py, without saturation). */
static const fo_real DIFFERENCE_MIN = (fo_real)0.02;
/* Sine times cosine of the angle by which the axis may have moved during the tests [1]: 12 degrees.
 * Then the axis is searched again. A rotor that turns answers along the old axis as if it were
 * saturated. */
static const fo_real MOVED = (fo_real)0.2;
/* Shares by which the amplitude of the ripple rises and falls in a sample [1]. */
static const fo_real RISE = (fo_real)0.02, FALL = (fo_real)0.002;
/* Smallest amplitude as a share of the largest [1], so that the row of the direction does not
 * vanish. */
static const fo_real LEAST = (fo_real)0.1;
/* Samples without the observer's filter after which the search begins again. */
static const uint32_t LOST_AFTER_SAMPLES = 200U;

bool fo_injector_init(fo_injector *p, const fo_injector_config *c)
{
    (void)memset(p, 0, sizeof *p);
    const fo_real all = c->sample_time + c->L_d + c->L_q + c->psi_f + c->current + c->voltage + c->bias +
                        c->current_noise + c->std + c->speed;
    bool usable = all - all == ZERO && c->sample_time > ZERO && c->L_d > ZERO && c->L_q > ZERO &&
                  c->psi_f >= ZERO && c->current > ZERO && c->voltage > ZERO &&
                  c->bias >= ZERO && c->current_noise > ZERO && c->std > ZERO && c->speed >= ZERO;
    if (usable) {
        p->config = *c;
        p->volts = TWO * c->L_d / c->sample_time;
        p->most = c->voltage / p->volts;
        p->most = c->current < p->most ? c->current : p->most;
        p->saliency = ONE - c->L_q / c->L_d;
        /* a sum with alternating signs adds the four-fold amplitude of a second difference's noise */
        p->noise_square = (fo_real)16 * c->current_noise * c->current_noise;
        const fo_real axis = c->L_q / (AXIS_STD * p->saliency);
        p->axis_weight = p->noise_square * axis * axis;
        usable = fo_abs(p->saliency) > SALIENCY_MIN && (c->psi_f > ZERO || c->bias > ZERO) &&
                 p->axis_weight - p->axis_weight == ZERO;
    }
    return usable;
}

void fo_injector_reset(fo_injector_state *s) { (void)memset(s, 0, sizeof *s); }

/* Second differences since the last two samples: of the voltage's integral [V s], of the current
 * [A]. */
typedef struct {
    fo_real volt_seconds[FO_N], current[FO_N];
} second_difference;

static void take_sample(const fo_injector *p, fo_injector_state *s, const fo_real voltage[FO_N],
                        const fo_real current[FO_N], second_difference *d, fo_injection *injection)
{
    for (int i = 0; i < FO_N; i++) {
        const fo_real difference = current[i] - s->current[i];
        d->volt_seconds[i] = (voltage[i] - s->voltage[i]) * p->config.sample_time;
        d->current[i] = difference - s->difference[i];
        injection->current[i] = (current[i] + s->current[i]) / TWO;
        s->difference[i] = difference;
        s->current[i] = current[i];
        s->voltage[i] = voltage[i];
    }
}

static void next_phase(fo_injector_state *s, fo_inject_phase phase)
{
    s->phase = phase;
    s->count = 0U;
    s->samples = 0U;
}

static void search_again(fo_injector_state *s)
{
    s->cosine = ZERO;
    s->sine = ZERO;
    s->weight = ZERO;
    next_phase(s, FO_INJECT_AXIS);
}

/* The observer starts at the axis, with `weight_other` at half a turn from it. */
static void start_observer(const fo_injector *p, fo_injector_state *s, fo_real weight_other,
                           fo_injection *injection)
{
    fo_seed *seed = &injection->seed;
    const fo_real i_d = dot(s->axis, injection->current);
    seed->theta_e = s->theta;
    seed->theta_e_std = fo_sqrt(AXIS_STD * AXIS_STD + AXIS_TILT * AXIS_TILT);
    seed->psi_f = p->config.psi_f + (p->config.L_d - p->config.L_q) * i_d;
    seed->weight_other = weight_other;
    injection->start = true;
    s->amplitude = p->most;
    s->lost = 0U;
    next_phase(s, FO_INJECT_RUN);
}

/* Turns the axis by half a turn. */
static void flip(fo_injector_state *s)
{
    s->theta = wrap(s->theta + PI);
    s->axis[0] = -s->axis[0];
    s->axis[1] = -s->axis[1];
}

/* Adds a sample to the search. A second difference of x = flux - L_q i is along d, and is
 * (1 - L_q / L_d) times the component of the volt-seconds along d. */
static void search_axis(const fo_injector *p, fo_injector_state *s, const second_difference *d)
{
    const fo_real *w = d->volt_seconds;
    const fo_real x = w[0] - p->config.L_q * d->current[0], y = w[1] - p->config.L_q * d->current[1];
    s->cosine += x * w[0] - y * w[1];
    s->sine += x * w[1] + y * w[0];
    s->weight += dot(w, w);
    const fo_real amplitude = fo_abs(p->saliency) * s->weight / TWO;
    const fo_real all = s->cosine + s->sine + s->weight;
    const bool whole = s->count % (DIRECTION_SAMPLES * DIRECTIONS) == 0U;
    /* Below a third of the expected answer there is no saliency: noise has a fifteenth. */
    if (!(all - all == ZERO)) { /* after a sample that is not finite */
        search_again(s);
    } else if (whole && s->weight > p->axis_weight &&
        s->cosine * s->cosine + s->sine * s->sine > amplitude * amplitude / (fo_real)8) {
        const fo_real sign = p->saliency > ZERO ? ONE : -ONE;
        s->theta = fo_atan2(sign * s->sine, sign * s->cosine) / TWO;
        direction_of(s->theta, s->axis);
        if (dot(s->axis, s->last) < ZERO) { /* the half turn that the last start leaves */
            flip(s);
        }
        (void)memset(s->response, 0, sizeof s->response);
        (void)memset(s->excitation, 0, sizeof s->excitation);
        s->across = ZERO;
        s->rounds = 0U;
        next_phase(s, FO_INJECT_PLUS);
    } else {
        /* measure on */
    }
}

/* Decides the polarity, or tests it again in the other order: what changes steadily, such as the
 * angle of a rotor that turns, cancels in two tests. */
static void decide_polarity(const fo_injector *p, fo_injector_state *s, fo_injection *injection)
{
    const fo_real *r = s->response;
    fo_real e[2];
    for (int n = 0; n < 2; n++) { /* a voltage that did not alternate tells nothing */
        const bool excited = s->excitation[n] > EXCITATION_MIN * p->axis_weight;
        e[n] = excited ? s->excitation[n] : EXCITATION_MIN * p->axis_weight;
    }
    const fo_real apart = r[0] / e[0] - r[1] / e[1]; /* inverse inductances: saturation is ahead */
    const fo_real variance = p->noise_square * (ONE / e[0] + ONE / e[1]);
    const fo_real least = DIFFERENCE_MIN * (r[0] / e[0] + r[1] / e[1]) / TWO;
    const bool decided = apart * apart > DECIDED * DECIDED * variance + least * least;
    const fo_real across = s->across / (e[0] + e[1]); /* a share of 1 / L_d - 1 / L_q */
    s->rounds++;
    if (fo_abs(across) * p->config.L_q > MOVED * fo_abs(p->saliency)) {
        search_again(s);
    } else if (s->rounds % 2U != 0U) {
        next_phase(s, FO_INJECT_MINUS);
    } else if (decided || s->rounds >= TESTS) {
        if (decided && apart < ZERO) {
            flip(s);
        }
        start_observer(p, s, decided ? ZERO : ONE / TWO, injection);
    } else {
        next_phase(s, FO_INJECT_PLUS);
    }
}

/* Adds a sample to half a test of the polarity. */
static void test_polarity(const fo_injector *p, fo_injector_state *s, const second_difference *d,
                          fo_injection *injection)
{
    const bool plus = s->phase == FO_INJECT_PLUS, first = (s->rounds % 2U != 0U) != plus;
    const int n = (int)s->phase - (int)FO_INJECT_PLUS;
    const fo_real sign = plus ? ONE : -ONE, bias = p->config.bias;
    const bool reached = sign * dot(s->axis, injection->current) > BIAS_REACHED * bias;
    const fo_real excitation = dot(d->volt_seconds, s->axis);
    if (reached || s->samples > 0U || s->count > TEST_DELAY) {
        s->samples++;
        s->response[n] += dot(d->current, s->axis) * excitation;
        s->excitation[n] += excitation * excitation;
        s->across +=
            (s->axis[0] * d->current[1] - s->axis[1] * d->current[0]) * excitation;
    }
    if (!(p->config.psi_f > ZERO)) { /* the current magnetizes, and both half turns are the same */
        if (s->samples > 0U) {
            start_observer(p, s, ZERO, injection);
        }
    } else if (!(bias > ZERO) || s->moving) { /* no test, or none that motion leaves true */
        start_observer(p, s, ONE / TWO, injection);
    } else if (s->samples >= TEST_SAMPLES) {
        if (first) {
            next_phase(s, plus ? FO_INJECT_MINUS : FO_INJECT_PLUS);
        } else {
            decide_polarity(p, s, injection);
        }
    } else {
        /* measure on */
    }
}

/* Sets the amplitude to what the demanded std needs. Begins again if the observer's filter has
 * stopped: at the last half turn or, if that was a guess, at the other one. */
static void adjust(const fo_injector *p, fo_injector_state *s, const fo_adaptive_estimate *e)
{
    const fo_real speed = fo_abs(e->position.speed_e), most = p->most;
    const bool lost = !e->adapting && !e->position.valid && s->count > 1U;
    s->lost = lost ? s->lost + 1U : 0U;
    if (e->adapting) {
        s->theta = e->position.theta_e;
        s->guessed = e->weight_other > ZERO;
        s->ready = s->ready || e->position.valid || e->position.valid_reason == FO_UNCONFIRMED;
    } else {
        s->ready = e->position.valid;
    }
    if (s->lost > LOST_AFTER_SAMPLES) {
        s->moving = true;
        direction_of(s->guessed ? wrap(s->theta + PI) : s->theta, s->last);
        search_again(s);
    } else if (!(speed < p->config.speed) && !lost) {
        s->amplitude = ZERO;
    } else {
        const bool more = e->position.theta_e_std > p->config.std;
        s->amplitude += more ? RISE * most : -FALL * s->amplitude;
        s->amplitude = s->amplitude > most ? most
                       : s->amplitude < LEAST * most ? LEAST * most : s->amplitude;
    }
}

/* Writes voltage and bias for the next interval. */
static void write_output(const fo_injector *p, fo_injector_state *s,
                         const fo_adaptive_estimate *e, fo_injection *injection)
{
    fo_real along[FO_N], bias = ZERO, amplitude = p->most;
    if (s->phase == FO_INJECT_AXIS) {
        const uint32_t n = s->count / DIRECTION_SAMPLES % DIRECTIONS;
        direction_of((fo_real)n * PI / (fo_real)6, along);
    } else if (s->phase == FO_INJECT_RUN) {
        direction_of(e->position.theta_e, along);
        amplitude = s->amplitude;
        bias = p->config.psi_f > ZERO ? ZERO : p->config.bias;
        injection->ready = s->ready;
    } else {
        along[0] = s->axis[0];
        along[1] = s->axis[1];
        bias = s->phase == FO_INJECT_PLUS ? p->config.bias : -p->config.bias;
    }
    s->positive = !s->positive;
    const fo_real volts = (s->positive ? amplitude : -amplitude) * p->volts;
    for (int i = 0; i < FO_N; i++) {
        injection->voltage[i] = volts * along[i];
        injection->bias[i] = bias * along[i];
    }
}

void fo_inject(const fo_injector *p, fo_injector_state *s, const fo_adaptive_estimate *e,
               const fo_real voltage[FO_N], const fo_real current[FO_N], fo_injection *injection)
{
    second_difference d;
    (void)memset(injection, 0, sizeof *injection);
    take_sample(p, s, voltage, current, &d, injection);
    s->count++;
    if (s->phase == FO_INJECT_RUN) {
        adjust(p, s, e);
    } else if (s->phase != FO_INJECT_AXIS) {
        test_polarity(p, s, &d, injection);
    } else if (s->count > DIRECTION_SAMPLES) { /* the first samples have no difference */
        search_axis(p, s, &d);
    } else {
        /* wait */
    }
    write_output(p, s, e, injection);
}

#endif
