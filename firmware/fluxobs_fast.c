/* The adaptive observer's interrupt: the plain observer's step, integration, and the sums of a
 * block.
 *
 * SPDX-License-Identifier: MIT
 */
#include "fluxobs_adaptive.h"

#include "fluxobs_internal.h"
#include "fluxobs_learning.h"
#include "fluxobs_relation.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what determined their value ----------------------------- */

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
/* EMF over the std of the voltage's error by the parameters, from which a rotation tells the
 * polarity [1]. At 1 % of the rated speed the rows of the direction turn with the rotor at the wrong
 * polarity, too (tests/firmware/test_from_rest.py). */
static const fo_real POLARITY_STDS = (fo_real)4;
/* Samples in a row without a certain position after which the position must be confirmed again. */
static const uint32_t UNCERTAIN_AFTER = (uint32_t)FO_MAX_CONSECUTIVE_BAD;
/* A position is not valid if the power of its innovations exceeds this limit [1]: three stds. */
static const fo_real CONTRADICTION = (fo_real)9;
/* If the filter loses the position within this many rows (two turns), its parameters are reset
 * [1]. */
static const fo_real EARLY_ROWS = (fo_real)16;
/* The filter is wrong if the power of its innovations exceeds this limit [1]: four stds. */
static const fo_real INNOVATION_POWER_MAX = (fo_real)16;
/* The filter is wrong if a parameter is this many stds from its prior [1]. */
static const fo_real PARAMETER_STDS_MAX = (fo_real)4;
/* The filter is wrong if its angle differs from the guard's by 20 degrees for a turn [rad, rad]. */
static const fo_real DISAGREEMENT = PI / (fo_real)9;
static const fo_real DISAGREEMENT_TURN = TWO * PI;

/* ---- the inverter --------------------------------------------------------------------- */

/* Pade approximant of tanh(x), with an error below 0.0014; 1 where it would exceed 1. */
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

/* Amplitude-invariant vector of the soft signs of the phase currents. */
static void soft_signs(const fo_real phase[3], fo_real over, fo_real sign[3], fo_real vector[FO_N])
{
    for (int i = 0; i < 3; i++) {
        sign[i] = soft_sign(phase[i] * over);
    }
    vector[0] = (TWO * sign[0] - sign[1] - sign[2]) * (fo_real)(1.0 / 3.0);
    vector[1] = (sign[1] - sign[2]) * (fo_real)0.5773502691896258;
}

/* Adds the derivative of that vector by the current (alpha alpha, alpha beta, beta beta), times
 * `scale`, to `gradient`. */
static void add_sign_gradient(const fo_real sign[3], fo_real scale, fo_real gradient[3])
{
    fo_real slope[3];
    for (int i = 0; i < 3; i++) {
        slope[i] = scale * (ONE - sign[i] * sign[i]);
    }
    gradient[0] += ((fo_real)4 * slope[0] + slope[1] + slope[2]) * (fo_real)(1.0 / 6.0);
    gradient[1] += (slope[2] - slope[1]) * (fo_real)0.2886751345948129;
    gradient[2] += (slope[1] + slope[2]) / TWO;
}

/* Estimated voltage of one part of the inverter's loss [V]. */
static fo_real inverter_loss_part(const fo_adaptive *a, const fo_adaptive_state *s, int n)
{
    return a->inverter_mean + s->value[FO_INVERTER + n];
}

/* Is this a turn of the filter's slower work: signs of the currents, sums of the block, std, mail?
 * It alternates with the guard's rows. */
static bool is_filter_turn(const fo_adaptive_state *s) { return (s->sample_index & 1U) != 0U; }

/* Does the guard have a row in every second sample? A proven filter with a confirmed position needs
 * no more. */
static bool is_guard_slow(const fo_adaptive_state *s)
{
    return s->running && s->report.rows > PROVEN_AFTER && s->reason == FO_VALID &&
           s->confirmed > SWEEP;
}

/* With fewer than four samples in a block, each sample does all of the work. */
static bool is_quick(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return fo_abs(s->tracker.speed) * a->plain.sample_time * (fo_real)4 > BLOCK;
}

/* Updates the soft signs of the phase currents. They hold for the interval that ends with this
 * current and for the next one: the current is the middle of both. */
static void update_signs(const fo_adaptive *a, fo_adaptive_state *s, const fo_real current[FO_N])
{
    const fo_real alpha = current[0] - s->value[FO_OFFSET],
                  beta = current[1] - s->value[FO_OFFSET + 1];
    const fo_real half = alpha / TWO, root = (fo_real)0.8660254037844386 * beta;
    const fo_real phase[3] = {alpha, root - half, -root - half};
    fo_real sign[2][3];
    soft_signs(phase, a->over_current[0], sign[0], s->signs[0]);
    soft_signs(phase, a->over_current[1], sign[1], s->signs[1]);
    if ((s->sample_index & 2U) != 0U) { /* only offsets need it, and they change slowly */
        for (int i = 0; i < 3; i++) {
            s->loss_gradient[i] = ZERO;
        }
        for (int n = 0; n < 2; n++) {
            const fo_real scale = a->volt * inverter_loss_part(a, s, n) * a->over_current[n];
            add_sign_gradient(sign[n], scale, s->loss_gradient);
        }
    }
}

/* Voltage lost in the interval that ends with this current, in addition to the assumed resistance's
 * drop. The estimates of resistance error and inverter loss determine it; the asymmetry is not
 * included. `mean` is the mean current of the interval. */
static void predicted_loss(const fo_adaptive *a, fo_adaptive_state *s, const fo_real current[FO_N],
                           fo_real mean[FO_N], fo_real loss[FO_N])
{
    const fo_state *q = &s->plain;
    /* otherwise the current is not finite, or absurd */
    const bool plausible =
        dot(current, current) <= a->plain.current_limit * a->plain.current_limit;
    const fo_real *now = plausible ? current : q->current[0];
    for (int i = 0; i < FO_N; i++) {
        mean[i] = now[i];
        if (plausible && q->have_current) {
            mean[i] = mean_current_24(now[i], q->current[0][i], q->current[1][i],
                                      q->current[2][i]) *
                      (fo_real)(1.0 / 24.0);
        }
    }
    if (s->report.direction_gain > ZERO) { /* the current ripples from sample to sample */
        update_signs(a, s, mean);
    } else if (is_filter_turn(s)) {
        update_signs(a, s, now);
    } else {
        /* the signs hold for this interval, too */
    }
    const fo_real hard = inverter_loss_part(a, s, 0), soft = inverter_loss_part(a, s, 1);
    for (int i = 0; i < FO_N; i++) {
        loss[i] = s->value[FO_RESISTANCE] * mean[i] + hard * s->signs[0][i] + soft * s->signs[1][i];
    }
}

/* u + g conj(u) */
static void correct_asymmetry(const fo_adaptive_state *s, const fo_real u[FO_N],
                              fo_real corrected[FO_N]) {
    corrected[0] = u[0];
    corrected[1] = u[1];
#if FO_ASYMMETRIC
    const fo_real g0 = s->value[FO_ASYMMETRY];
    const fo_real g1 = s->value[FO_ASYMMETRY + 1];
    corrected[0] += g0 * u[0] + g1 * u[1];
    corrected[1] += g1 * u[0] - g0 * u[1];
#else
    (void)s;
#endif
}

/* ---- integration ---------------------------------------------------------------------- */

/* Adds to the block the change of the last interval's volt-seconds with each parameter. */
static void add_sensitivities(const fo_adaptive *a, fo_adaptive_state *s, bool complete,
                              const fo_real mean[FO_N])
{
    fo_block *b = &s->block;
    const fo_real volt = a->volt;
    for (int i = 0; i < FO_N; i++) {
        b->sensitivity[0][i] -= volt * mean[i];
        b->sensitivity[1][i] -= volt * s->signs[0][i];
        b->sensitivity[2][i] -= volt * s->signs[1][i];
        b->sensitivity[3][i] += s->loss_gradient[i];
        b->sensitivity[4][i] += s->loss_gradient[1 + i];
    }
#if FO_ASYMMETRIC
    fo_real u[FO_N];
    for (int i = 0; i < FO_N; i++) { /* the interval's voltage without the drop */
        const fo_real drop = complete ? (fo_real)24 * row_of(a->plain.hR, i, mean) : ZERO;
        u[i] = s->plain.source[i] + drop;
    }
    b->sensitivity[5][0] += u[0];
    b->sensitivity[5][1] -= u[1];
    b->sensitivity[6][0] += u[1];
    b->sensitivity[6][1] += u[0];
#else
    (void)complete;
#endif
    b->time += a->plain.h;
}

/* Updates the parameter-to-EMF ratio: the angle by which parameter errors may have turned the flux.
 * The ratio accumulates until the rotor has turned by a radian. `turned` is the rotation in these
 * `samples`. */
static void update_emf_ratio(const fo_adaptive *a, fo_adaptive_state *s, fo_real samples,
                             fo_real length, fo_real turned)
{
    const fo_real before = s->report.voltage_std_square;
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]);
    fo_real flux_std = s->report.voltage_std * a->plain.h * samples;
    if (square > before && before > ZERO) { /* larger now */
        flux_std *= fo_sqrt(square / before);
    }
    const fo_real decay = turned < ONE ? turned : ONE;
    const fo_real growth = length > ZERO ? flux_std / length : ONE;
    const fo_real ratio = s->emf_ratio + growth - s->emf_ratio * decay;
    s->emf_ratio = ratio < TWO ? ratio : TWO;
    if (!(a->std[FO_RESISTANCE] + a->std[FO_INVERTER] > ZERO)) { /* both are known */
        s->emf_ratio = ZERO;
    }
}

/* Linearises the map at the filter's own angle, because the guard's angle may differ. A cage's map
 * does not depend on the angle. */
static const fo_map_point *linearise_filter_map(const fo_adaptive *a, fo_adaptive_state *s)
{
#if FO_MAPPED
    const fo_observer *o = &a->plain;
    if (has_map(o) && s->running && !has_cage_map(o) && !s->plain.has_external_angle) {
        fo_linearise_map(o, predicted_angle(o, &s->tracker), s->plain.current[0], &s->map_point);
    } else {
        s->map_point = s->plain.map_point;
    }
    return &s->map_point;
#else
    (void)a;
    (void)s;
    return NULL;
#endif
}

/* Std of an angle with this variance: at most the std of an unknown angle. */
static fo_real capped_std(fo_real variance)
{
    return fo_sqrt(variance < VARIANCE_UNKNOWN ? variance : VARIANCE_UNKNOWN);
}

/* Is this a turn of the mail? The mail shares a sample with the least other work. */
static bool is_mail_turn(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return is_quick(a, s) || is_filter_turn(s) == is_guard_slow(s);
}

/* ---- the mail to the learner ----------------------------------------------------------- */

static void clear_block(fo_adaptive_state *s)
{
    (void)memset(&s->block, 0, sizeof s->block);
    if (s->running) {
        (void)memset(&s->now.sums, 0, sizeof s->now.sums);
    }
}

/* Sends the block to the learner, which must have no mail. */
static void post(const fo_adaptive *a, fo_adaptive_state *s, const fo_real mean[FO_N])
{
    fo_mail *m = &s->mail;
    fo_block_end *end = &m->end;
    const fo_state *q = &s->plain;
    m->searching = !s->running;
    m->place = s->place;
    m->forget = s->forget;
    m->block = s->block;
    for (int i = 0; i < FO_N; i++) {
        end->flux[i] = s->flux[i];
        end->current[i] = q->current[0][i];
        end->mean_current[i] = mean[i];
        end->signs[0][i] = s->signs[0][i];
        end->signs[1][i] = s->signs[1][i];
    }
    end->noise_inflation = q->noise_inflation;
    end->emf_ratio = s->emf_ratio;
    end->speed = s->tracker.speed;
#if FO_MAPPED
    end->map_point = s->map_point;
#endif
    if (s->running) {
        m->data.sums = s->now.sums;
    } else {
        fo_search_data *data = &m->data.search;
        data->info = q->info;
        data->power = q->power;
        for (int i = 0; i < FO_N; i++) {
            data->flux[i] = q->x[FLUX + i];
            data->drift[i] = q->x[DRIFT + i];
            data->direction[i] = s->x[i];
            data->armature_flux[i] = armature_flux(&a->plain, q, i);
        }
        data->rotation = s->rotation;
        data->trusted = q->trusted;
        data->settled = s->tracker.settled >= TRACKER_SETTLED;
    }
    clear_block(s);
    s->place = false;
    s->forget = false;
    FO_RELEASE(m->owner, FO_MAIL_WITH_LEARNER);
}

/* Moves the sums of the present block to the corrected flux, drift and parameters. */
static void correct_residuals(fo_sums *sums, const fo_answer *c)
{
    sums->ripple.product += dot(sums->ripple.h, c->flux) + dot(sums->ripple.th, c->drift);
    for (int w = 0; w < (int)FO_NW; w++) {
        fo_real sum = dot(sums_of_h(sums, w), c->flux) + dot(sums_of_th(sums, w), c->drift) -
                      c->change[FO_PSI] * sum_of_weight(sums, w);
        for (int j = 1; j < (int)FO_NP; j++) {
            sum += sums->by_parameter[j - 1][w] * c->change[j];
        }
        sums->residual[w] += sum;
    }
}

static void take_values(const fo_adaptive *a, fo_adaptive_state *s, const fo_answer *c)
{
    fo_real now[FO_PRIOR_MEANS];
    fo_learning_prior_means(a, now); /* they differ from the learner's just after a retuning */
    s->report = c->report;
    for (int j = 0; j < (int)FO_NP; j++) {
        s->value[j] = c->value[j];
    }
    fo_learning_shift_values(c->means, now, s->value);
}

/* Corrects flux, drift and parameters since the end of the learner's block. */
static void take_correction(const fo_adaptive *a, fo_adaptive_state *s, const fo_answer *c)
{
    const fo_block *b = &s->block;
    correct_residuals(&s->now.sums, c);
    for (int i = 0; i < FO_N; i++) {
        fo_real flux = s->flux[i] + c->flux[i] + b->time * c->drift[i];
        for (int j = 0; j < (int)FO_NS; j++) {
            flux += b->sensitivity[j][i] * c->change[FO_RESISTANCE + j];
        }
        s->flux[i] = flux;
        s->drift[i] += c->drift[i];
    }
    take_values(a, s, c);
    s->ripple_samples = 0U; /* the angle has changed */
    /* A row of the direction limits the flux error like a rotation by its gain [rad]. */
    const fo_real kept = ONE - s->report.direction_gain;
    s->emf_ratio *= kept;
    s->voltage_turn *= kept;
    if (!(s->half_turn > ZERO)) { /* as much evidence as a rotation by this gain */
        s->confirmed += s->report.direction_gain;
    }
}

/* Takes a candidate, or starts the filter from it. */
static void take_candidate(const fo_adaptive *a, fo_adaptive_state *s, const fo_answer *c)
{
    s->has_candidate = c->kind != FO_ANSWER_NONE;
    s->other_weight = c->other_weight;
    s->other_theta = c->other_theta;
    if (s->has_candidate) {
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] = c->flux[i] + s->block.volt_seconds[i] + s->block.time * c->drift[i];
            s->drift[i] = c->drift[i];
        }
        s->length = c->length;
        s->variance = c->variance;
    }
    if (c->other_direction) {
        s->tracker.settled = ZERO;
    }
    if (c->kind == FO_ANSWER_START) {
        s->running = true;
        s->std = capped_std(VARIANCE_UNKNOWN);
        s->reason = FO_SEARCHING;
        s->voltage_turn = ZERO;
        s->disagreement = ZERO;
        s->block.turned = ZERO;
        s->ripple_samples = 0U;
        (void)memset(&s->now.sums, 0, sizeof s->now.sums);
        if (a->projection == FO_PROJECT_NEVER) {
            s->tracker = s->plain.tracker;
        }
    }
    take_values(a, s, c);
}

/* Takes the learner's answer. Returns whether the answer is implausible. */
static bool receive(const fo_adaptive *a, fo_adaptive_state *s)
{
    bool wrong = false;
    if (FO_ACQUIRE(s->mail.owner) == FO_MAIL_ANSWERED) {
        const fo_answer *answer = &s->mail.data.answer;
        if (s->discard) {
            s->discard = false;
        } else if (answer->wrong) {
            wrong = true;
        } else if (answer->kind == FO_ANSWER_CORRECTION) {
            take_correction(a, s, answer);
        } else {
            take_candidate(a, s, answer);
        }
        FO_RELEASE(s->mail.owner, FO_MAIL_FREE);
    }
    return wrong;
}

/* Stops the filter; the learner shall place new candidates. The parameters keep their estimates
 * unless the filter was wrong. */
static void stop_filter(const fo_adaptive *a, fo_adaptive_state *s, bool wrong)
{
    s->running = false;
    s->half_turn = ZERO;
    s->has_candidate = false;
    s->rotation = ZERO;
    s->other_weight = ONE / TWO;
    s->place = true;
    s->discard = FO_ACQUIRE(s->mail.owner) != FO_MAIL_FREE;
    clear_block(s);
    if (wrong) {
        s->restarts++;
    }
    if (wrong && !s->learner.frozen) {
        fo_learning_report *r = &s->report;
        s->forget = true;
        (void)memset(s->value, 0, sizeof s->value);
        r->reported_std[0] = a->std[FO_PSI];
        r->reported_std[1] = a->std[FO_RESISTANCE];
        r->reported_std[2] = fo_sqrt(TWO) * a->std[FO_INVERTER];
        r->voltage_std = ZERO;
        s->emf_ratio = TWO;
    }
}

/* ---- estimates ------------------------------------------------------------------------ */

/* Writes the parameters into the estimate. */
static void write_parameters(const fo_adaptive *a, const fo_adaptive_state *s,
                              fo_adaptive_estimate *e)
{
    e->psi_f_std = s->report.reported_std[0] * a->plain.flux_base;
    e->resistance_error = s->value[FO_RESISTANCE];
    e->resistance_std = s->report.reported_std[1];
    e->inverter_voltage = inverter_loss_part(a, s, 0) + inverter_loss_part(a, s, 1);
    e->inverter_std = s->report.reported_std[2];
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
    } else if (!(s->report.innovation_power < CONTRADICTION)) {
        reason = FO_CONTRADICTED;
    } else if (!(variance < STD_LIMIT * STD_LIMIT && all < STD_ALL * STD_ALL)) {
        reason = FO_UNCERTAIN;
    } else {
        /* valid */
    }
    return reason;
}

/* Writes flux, drift and angle of the filter or of a candidate; `length` is that of the position
 * vector. */
static void write_position(const fo_adaptive *a, const fo_adaptive_state *s, fo_real length,
                           fo_real std, fo_reason reason, fo_estimate *q)
{
    for (int i = 0; i < FO_N; i++) {
        q->flux[i] = s->flux[i] * a->plain.flux_base;
        q->drift[i] = s->drift[i] * a->plain.drift_base;
    }
    q->psi_f = length * a->plain.flux_base;
    q->theta_e = s->theta;
    q->theta_e_tracked = s->tracker.angle;
    q->speed_e = s->tracker.speed;
    q->theta_e_std = std;
    set_reason(q, reason);
}

/* Writes the filter's estimate. */
static void write_filter_estimate(const fo_adaptive *a, const fo_adaptive_state *s, fo_real length,
                                  fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_estimate *q = &e->position;
    write_position(a, s, length, s->std, s->reason, q);
    q->noise_share = ZERO;
    e->psi_f = (a->psi + s->value[FO_PSI]) * o->flux_base;
#if FO_MAPPED
    if (has_cage_map(o)) {
        e->psi_f += s->plain.map_point.active_flux * o->flux_base;
    }
#endif
    e->drift_std = o->drift_prior_std * o->drift_base * s->report.drift_std;
    e->theta_other = s->half_turn > ZERO ? wrap(q->theta_e + PI) : q->theta_e;
    e->weight_other = s->half_turn;
}

/* Writes the plain observer's position. The plain observer's std does not include the parameters,
 * so their part is added. */
static void use_plain_estimate(const fo_adaptive_state *s, fo_adaptive_estimate *e)
{
    fo_estimate *q = &e->position;
    q->theta_e_std = capped_std(q->theta_e_std * q->theta_e_std + s->emf_ratio * s->emf_ratio);
    if (q->valid && !(q->theta_e_std < STD_LIMIT)) {
        set_reason(q, FO_UNCERTAIN);
    }
}

/* Variance of the angle due to the considered parameters: lags of voltages and currents, unequal
 * gains of the current sensors, iron loss, harmonics of the magnet flux. At constant speed and load
 * they leave no residual. `square` is the squared length of the position vector. */
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

/* Variance of the flux across the position vector, between two blocks. At another load, the errors
 * of the parameters have not yet been correlated with the flux. */
static fo_real flux_variance(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_learning_report *r = &s->report;
    const fo_real time = s->block.time;
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]);
    const fo_real change = (square - r->voltage_std_square) * a->over_rated * a->over_rated;
    fo_real growth = r->growth;
    if (fo_abs(change) > NEW_POINT * NEW_POINT) {
        const fo_real ratio =
            square > r->voltage_std_square && r->voltage_std_square > ZERO
                ? square / r->voltage_std_square : ONE;
        const fo_real raw = r->voltage_std * r->voltage_std * ratio;
        growth = raw > growth ? raw : growth;
    }
    return r->variance_across + growth * time * time;
}

/* Updates std and validity of the filter's position: `turned` is the rotation in these `samples`.
 * Returns the variance of the angle without errors of inductance and lag. */
static fo_real update_std(const fo_adaptive *a, fo_adaptive_state *s,
                          const fo_linearisation *point, fo_real samples, fo_real turned)
{
    const fo_observer *o = &a->plain;
    const fo_learning_report *r = &s->report;
    const fo_real square = point->length * point->length;
    const fo_real apart[FO_N] = {s->signs[0][0] - s->signs[1][0],
                                 s->signs[0][1] - s->signs[1][1]};
    const fo_real knee = fo_sqrt(dot(apart, apart)), time = samples * o->h;
    const fo_real inverter = (INVERTER_UNMODELLED + KNEE_UNMODELLED * knee) * r->loss_size * time;
    const fo_real other = VOLTAGE_TURN * o->drift_prior_std * time;
    const fo_real step = turned < ONE ? turned : ONE;
    s->block.unmodelled += inverter;
    s->voltage_turn += (other + inverter) / point->length - s->voltage_turn * step;
    const fo_real noise = o->position_noise * s->plain.noise_inflation;
    const fo_real change =
        a->std[FO_INDUCTANCE + 1] * (point->armature_flux[1] - r->armature_flux_q);
    /* negative if the rows have correlated the error of L_q with the flux: both turn x less */
    const fo_real by_L_q = r->variance_by_L_q + change * change;
    const fo_real variance =
        (flux_variance(a, s) + noise + (by_L_q < ZERO ? by_L_q : ZERO)) / square +
        s->voltage_turn * s->voltage_turn / (fo_real)3; /* the turn is a bound: a uniform error */
    const fo_real all = variance + (by_L_q > ZERO ? by_L_q : ZERO) / square +
                        considered_variance(a, s, square) + r->tilt;
    s->std = capped_std(all);
    s->reason = judge_filter(s, variance, all);
    return variance;
}

/* ---- the filter, guarded -------------------------------------------------------------- */

/* Does the filter contradict its guard, its model or its prior? */
static bool is_wrong(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real *std = a->std, *value = s->value, most = PARAMETER_STDS_MAX;
    return s->disagreement > DISAGREEMENT_TURN ||
           s->report.innovation_power > INNOVATION_POWER_MAX ||
           fo_abs(value[FO_RESISTANCE]) > most * std[FO_RESISTANCE] ||
           fo_abs(value[FO_INDUCTANCE]) > most * std[FO_INDUCTANCE] ||
           fo_abs(value[FO_INDUCTANCE + 1]) > most * std[FO_INDUCTANCE + 1];
}

/* Adds a sample's residual |x| - length_by_current - psi_f and its gradients to the sums. */
static void add_sample(const fo_adaptive *a, fo_adaptive_state *s, const fo_map_point *map,
                       const fo_linearisation *point)
{
    fo_sums *sums = &s->now.sums;
    const fo_block *b = &s->block;
    const fo_real t = b->time;
    fo_real h[FO_N], by_current[FO_N], by_parameter[FO_NP - 1];
    fo_residual_gradients(a, map, point, h, by_current);
    for (int j = 0; j < (int)FO_NS; j++) {
        by_parameter[j] = dot(h, b->sensitivity[j]);
    }
    for (int i = 0; i < FO_N; i++) {
        by_parameter[FO_OFFSET - 1 + i] += by_current[i];
    }
    by_parameter[FO_INDUCTANCE - 1] = -point->armature_flux[0];
    by_parameter[FO_INDUCTANCE] =
        -point->armature_flux[1] * component_across(point->direction, h);
    for (int j = 0; j < (int)FO_NP - 1; j++) {
        fo_real *to = sums->by_parameter[j];
        to[0] += by_parameter[j];
        to[1] += by_parameter[j] * h[0];
        to[2] += by_parameter[j] * h[1];
    }
    const fo_real residual =
        point->length - point->length_by_current - (a->psi + s->value[FO_PSI]);
    sums->residual[0] += residual;
    sums->residual[1] += residual * h[0];
    sums->residual[2] += residual * h[1];
    const fo_real hh[3] = {h[0] * h[0], h[0] * h[1], h[1] * h[1]};
    for (int i = 0; i < FO_N; i++) {
        sums->h[i] += h[i];
        sums->th[i] += t * h[i];
    }
    for (int i = 0; i < 3; i++) {
        sums->hh[i] += hh[i];
        sums->thh[i] += t * hh[i];
    }
    sums->samples++;
}

/* Is the machine salient? Otherwise the length of x does not change with the current. */
static bool is_salient(const fo_adaptive *a)
{
    return fo_abs(a->saliency) > ZERO || (has_map(&a->plain) && !has_cage_map(&a->plain));
}

/* Adds a sample to the sums for the row of the direction, before `s->theta` becomes `theta`. */
static void add_ripple(const fo_adaptive *a, fo_adaptive_state *s, bool measured, fo_real theta,
                       const fo_linearisation *point)
{
    fo_ripple *p = &s->now.sums.ripple;
    const fo_real u = ONE / point->length, change = u - s->inverse_length;
    if (s->ripple_samples > 1U && measured) {
        const fo_real r = wrap(theta - s->theta) - s->tracker.speed * a->plain.sample_time;
        const fo_real square = change * change, t = square * s->block.time;
        p->samples++;
        p->product += change * r;
        p->square += square;
        p->lagged += change * s->ripple;
        p->h[0] -= square * point->direction[1];
        p->h[1] += square * point->direction[0];
        p->th[0] -= t * point->direction[1];
        p->th[1] += t * point->direction[0];
        for (int n = 0; n < 2; n++) {
            p->signs[n] += change * u * (point->direction[0] * s->signs[n][1] -
                                         point->direction[1] * s->signs[n][0]);
        }
    }
    s->ripple_samples = measured ? s->ripple_samples + 1U : 0U;
    s->ripple = change;
    s->inverse_length = u;
}

/* Integrates the filter's flux, and may add the sample to the block. Returns whether the position
 * vector is plausible. */
static bool step_filter(const fo_adaptive *a, fo_adaptive_state *s, bool measured, bool add,
                        fo_linearisation *point)
{
    const fo_observer *o = &a->plain;
    const fo_map_point *map = linearise_filter_map(a, s);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] += s->plain.volt_seconds[i] + o->h * s->drift[i];
    }
    fo_linearise(a, s->value, s->flux, s->plain.current[0], map, point);
    const bool plausible = point->length * point->length > o->square_min / (fo_real)16 &&
                           dot(s->flux, s->flux) < RUNAWAY;
    if (plausible) {
        if (measured && add) {
            add_sample(a, s, map, point);
        }
        const fo_real theta = fo_atan2(point->x[1], point->x[0]);
        if (is_salient(a)) {
            add_ripple(a, s, measured, theta, point);
        }
        s->block.turned += wrap(theta - s->theta);
        s->theta = theta;
        s->x[0] = point->direction[0];
        s->x[1] = point->direction[1];
    }
    return plausible;
}

/* Updates std and validity after these `samples`. Stops the filter if it is lost or wrong. */
static void update_status(const fo_adaptive *a, fo_adaptive_state *s,
                          const fo_linearisation *point, fo_real samples)
{
    const fo_real turned = fo_abs(s->tracker.speed) * a->plain.sample_time * samples;
    update_emf_ratio(a, s, samples, point->length, turned);
    const fo_real variance = update_std(a, s, point, samples, turned);
    const bool is_finite = variance - variance == ZERO;
    const bool wrong = !is_finite || is_wrong(a, s);
    const bool lost = s->emf_ratio > ONE ||
                      (s->report.rows > LOST_AFTER && !(variance < STD_LOST * STD_LOST));
    const bool early = lost && s->report.rows < EARLY_ROWS &&
                       s->report.reported_std[1] > a->std[FO_RESISTANCE] / TWO;
    if (wrong || lost) {
        stop_filter(a, s, wrong || early);
    }
}

/* Sends a block that has ended. It lasts until the learner is free. */
static void send_block(const fo_adaptive *a, fo_adaptive_state *s, const fo_real mean[FO_N])
{
    const bool ended = fo_abs(s->block.turned) >= BLOCK || s->block.time >= BLOCK_MAX;
    if (ended && FO_ACQUIRE(s->mail.owner) == FO_MAIL_FREE) {
        post(a, s, mean);
    }
}

/* Compares the filter's angle with that of its guard, the plain observer, after these `samples`. */
static void compare_with_guard(const fo_adaptive *a, fo_adaptive_state *s, fo_real samples,
                               const fo_estimate *plain)
{
    if (plain->valid) {
        const bool differs = fo_abs(wrap(s->theta - plain->theta_e)) > DISAGREEMENT;
        const fo_real turned = fo_abs(s->tracker.speed) * a->plain.sample_time * samples;
        s->disagreement = differs ? s->disagreement + turned : ZERO;
    }
}

/* Processes a sample while the filter runs. `e` holds the estimate of the plain observer, the
 * filter's guard, if `guarded`. */
static void run_filter(const fo_adaptive *a, fo_adaptive_state *s, const fo_real mean[FO_N],
                       bool measured, bool guarded, fo_adaptive_estimate *e)
{
    fo_linearisation point;
    const bool quick = is_quick(a, s), slower = quick || is_filter_turn(s);
    const fo_real samples = quick ? ONE : TWO;
    if (step_filter(a, s, measured, slower, &point)) {
        track(&a->plain, &s->tracker, s->theta);
        settle_tracker(&a->plain, &s->tracker, s->theta, s->std);
        if (slower) {
            update_status(a, s, &point, samples);
        }
        if (guarded && (quick || !slower)) {
            compare_with_guard(a, s, samples, &e->position);
        }
        if (s->running && is_mail_turn(a, s)) {
            send_block(a, s, mean);
        }
        if (e->position.valid && !(s->report.rows > PROVEN_AFTER)) {
            use_plain_estimate(s, e);
        } else {
            write_filter_estimate(a, s, point.length, e);
        }
        write_parameters(a, s, e);
    } else {
        stop_filter(a, s, true);
        if (!guarded) {
            write_filter_estimate(a, s, ONE, e);
            set_reason(&e->position, FO_SEARCHING);
        }
    }
}

/* ---- the start ------------------------------------------------------------------------ */

/* Writes the best candidate's position. The variance includes the weight of the second best
 * candidate. */
static void write_candidate(const fo_adaptive *a, const fo_adaptive_state *s, fo_estimate *q)
{
    const fo_real apart = wrap(s->other_theta - s->theta);
    const fo_real std = capped_std(s->variance + s->other_weight * apart * apart);
    write_position(a, s, s->length, std, FO_SEARCHING, q);
}

/* Integrates the best candidate. */
static void step_candidate(const fo_adaptive *a, fo_adaptive_state *s)
{
    const fo_observer *o = &a->plain;
    fo_real x[FO_N];
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] += s->plain.volt_seconds[i] + o->h * s->drift[i];
        x[i] = s->flux[i] - armature_flux(o, &s->plain, i);
    }
    const fo_real theta = fo_atan2(x[1], x[0]);
    const bool likely = s->other_weight < ONE / TWO;
    s->rotation = likely ? s->rotation + wrap(theta - s->theta) : ZERO;
    s->theta = theta;
    track(o, &s->tracker, theta);
    settle_tracker(o, &s->tracker, theta, fo_sqrt(s->variance));
}

/* Processes a sample before the filter runs. */
static void run_start(const fo_adaptive *a, fo_adaptive_state *s, const fo_real mean[FO_N],
                      fo_adaptive_estimate *e)
{
    fo_estimate *q = &e->position;
    const fo_real turned =
        s->plain.trusted ? fo_abs(s->plain.tracker.speed) * a->plain.sample_time : ZERO;
    update_emf_ratio(a, s, ONE, s->plain.length, turned);
    (void)linearise_filter_map(a, s);
    s->block.samples++;
    for (int i = 0; i < FO_N; i++) {
        s->block.volt_seconds[i] += s->plain.volt_seconds[i];
    }
    if (s->has_candidate) {
        step_candidate(a, s);
    } else {
        s->rotation = ZERO;
    }
    s->seeded = s->seeded && !s->plain.trusted && q->theta_e_std < capped_std(VARIANCE_UNKNOWN);
    if (a->projection != FO_PROJECT_NEVER) {
        e->weight_other = s->other_weight;
        if (s->has_candidate && s->other_weight < ONE / TWO) {
            e->theta_other = s->other_theta;
        }
        if (s->plain.trusted) {
            use_plain_estimate(s, e);
        } else if (s->has_candidate && !s->seeded) {
            write_candidate(a, s, q);
        } else {
            /* the estimate is still that of the plain observer */
        }
    }
    if (is_mail_turn(a, s) && FO_ACQUIRE(s->mail.owner) == FO_MAIL_FREE) {
        post(a, s, mean);
    }
}

/* Does the EMF tell the polarity: is it far above the error of the voltage by the parameters? */
static bool is_polarity_visible(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_learning_report *r = &s->report;
    const fo_real speed = s->tracker.speed * a->plain.sample_time / a->plain.h;
    const fo_real std = POLARITY_STDS * r->voltage_std * s->inverse_length;
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]);
    const fo_real more = square > r->voltage_std_square && r->voltage_std_square > ZERO
                             ? square / r->voltage_std_square : ONE;
    return speed * speed > std * std * more;
}

/* A certain position becomes valid after half a turn, because a wrong flux changes the length of the
 * position vector within that rotation. After a jump, or a std above twice its limit, the position
 * must be confirmed again. */
static void confirm(const fo_adaptive *a, fo_adaptive_state *s, fo_estimate *q)
{
    const bool certain = q->theta_e_std < TWO * STD_LIMIT && q->valid_reason != FO_SEARCHING &&
                         follows(&s->tracker, q->theta_e, q->theta_e_std);
    s->uncertain = certain ? 0U : s->uncertain + 1U;
    if (s->uncertain > UNCERTAIN_AFTER) {
        s->confirmed = ZERO;
    } else if (!(s->half_turn > ZERO) || is_polarity_visible(a, s)) {
        s->confirmed += fo_abs(s->tracker.speed) * a->plain.sample_time;
    } else {
        /* rows of the direction follow the rotor at either polarity */
    }
    if (s->confirmed > SWEEP) {
        s->half_turn = ZERO;
    } else if (q->valid) {
        set_reason(q, FO_UNCONFIRMED);
    } else {
        /* another reason */
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
                          const fo_real mean[FO_N], bad_samples before, bool guarded,
                          fo_adaptive_estimate *e)
{
    const bad_samples now = count_bad_samples(&s->plain);
    const bool measured = now.currents == before.currents;
    e->theta_other = e->position.theta_e;
    e->weight_other = e->position.valid ? ZERO : ONE / TWO;
    e->psi_f = e->position.psi_f;
    e->drift_std = a->plain.drift_prior_std * a->plain.drift_base;
    e->adapting = s->running;
    if (s->plain.have_current && s->plain.have_voltage) {
        add_sensitivities(a, s, complete, mean);
        if (s->running) {
            run_filter(a, s, mean, measured, guarded, e);
        } else {
            run_start(a, s, mean, e);
        }
    } else {
        e->adapting = false;
        if (!s->plain.have_current && s->running) {
            stop_filter(a, s, false);
        }
        if (!s->running) { /* else the filter waits for the first interval after a seed */
            s->emf_ratio = TWO;
        }
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

/* Resets a damaged state, and takes the learner's answer. */
static void prepare_sample(const fo_adaptive *a, fo_adaptive_state *s)
{
    if (may_be_damaged(&s->plain) && fo_damaged(&a->plain, &s->plain)) {
        const uint32_t restarts = s->plain.restarts, owner = FO_ACQUIRE(s->mail.owner);
        fo_adaptive_reset(a, s);
        s->plain.restarts = restarts + 1U;
        if (owner == FO_MAIL_WITH_LEARNER) { /* it may be at work on the mail */
            FO_RELEASE(s->mail.owner, owner);
            s->discard = true;
        }
    }
    if (is_mail_turn(a, s) && receive(a, s)) {
        stop_filter(a, s, true);
    }
}

/* Subtracts the asymmetry and the predicted loss from voltages, or from volt-seconds of an interval
 * of this duration. `mean` is the mean current of the interval. */
static void correct_source(const fo_adaptive *a, fo_adaptive_state *s, const fo_real source[FO_N],
                           fo_real duration, const fo_real current[FO_N], fo_real mean[FO_N],
                           fo_real corrected[FO_N])
{
    fo_real loss[FO_N];
    predicted_loss(a, s, current, mean, loss);
    correct_asymmetry(s, source, corrected);
    for (int i = 0; i < FO_N; i++) {
        corrected[i] -= duration * loss[i];
    }
    set_map_angle(a, s);
}

/* The guard's step. While the position is confirmed, the guard has a row in every second sample,
 * which halves its cost. Returns whether the guard has written its estimate. */
static bool step_guard(const fo_adaptive *a, fo_adaptive_state *s, const fo_real input[FO_N],
                       bool complete, const fo_real current[FO_N], fo_estimate *e)
{
    const bool begins = is_guard_slow(s) && is_filter_turn(s) && !is_quick(a, s) &&
                        !s->merged.pending;
    if (s->merged.pending) {
        fo_observer rows;
        rows = a->plain;
        rows.h += a->plain.h;
        rows.rho -= a->plain.h;
        rows.sample_time += a->plain.sample_time;
        rows.reinject = a->guard_reinject;
        for (int i = 0; i < 3; i++) {
            rows.track[i] = a->guard_track[i];
        }
        fo_step_merged(&a->plain, &rows, &s->plain, &s->merged, false, input, complete, current, e);
    } else {
        fo_step_merged(&a->plain, &a->plain, &s->plain, &s->merged, begins, input, complete,
                       current, e);
    }
    const bool guarded = !s->merged.pending;
    if (!guarded) { /* the filter writes the rest */
        e->innovation = s->plain.innovation;
        e->theta_e = s->theta;
        e->psi_f = s->length;
        set_reason(e, FO_SEARCHING);
    }
    return guarded;
}

static void fast_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real input[FO_N],
                      bool complete, const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    prepare_sample(a, s);
    const bad_samples before = count_bad_samples(&s->plain);
    fo_real mean[FO_N], corrected[FO_N];
    correct_source(a, s, input, complete ? a->plain.sample_time : ONE, current, mean, corrected);
    const bool guarded = step_guard(a, s, corrected, complete, current, &e->position);
    finish_sample(a, s, complete, mean, before, guarded, e);
}

void fo_adaptive_fast_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real voltage[FO_N],
                           const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    fast_step(a, s, voltage, false, current, e);
}

void fo_adaptive_fast_step_volt_seconds(const fo_adaptive *a, fo_adaptive_state *s,
                                        const fo_real volt_seconds[FO_N],
                                        const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    fast_step(a, s, volt_seconds, true, current, e);
}

void fo_adaptive_fast_step_for(const fo_adaptive *a, fo_adaptive_state *s, fo_real duration,
                               const fo_real voltage[FO_N], const fo_real current[FO_N],
                               fo_adaptive_estimate *e)
{
    fo_adaptive now;
    fo_gathered g;
    now = *a;
    fo_uneven(&a->plain, &s->plain, duration, voltage, current, &now.plain, &g);
    now.volt = a->volt * (now.plain.sample_time / a->plain.sample_time);
    fast_step(&now, s, g.volt_seconds, true, g.current, e);
}
