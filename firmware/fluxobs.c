/* SPDX-License-Identifier: MIT */
#include "fluxobs_algebra.h"

#include <string.h>

static const fo_real ATAN[] = FO_ATAN_SERIES;

fo_real fo_atan2(fo_real y, fo_real x)
{
    const fo_real up = fo_abs(y), along = fo_abs(x);
    const bool steep = up > along;
    const fo_real less = steep ? along : up, more = steep ? up : along;
    fo_real from = ZERO, q = more > ZERO ? less / more : more; /* zero, or NaN */
    if (q > FO_NEAR_BETWEEN) {
        from = PI / (fo_real)4;
        q = (less - more) / (more + less);
    } else if (q > FO_NEAR_ZERO) {
        from = FO_BETWEEN;
        q = (less - FO_TAN_BETWEEN * more) / (more + FO_TAN_BETWEEN * less);
    } else {
        /* near the axis */
    }
    const fo_real square = q * q;
    fo_real series = ATAN[0];
    for (size_t k = 1; k < sizeof ATAN / sizeof ATAN[0]; k++) {
        series = ATAN[k] + square * series;
    }
    fo_real angle = from + (q + q * (square * series));
    angle = steep ? PI / TWO - angle : angle;
    angle = x < ZERO ? PI - angle : angle;
    return y < ZERO ? -angle : angle;
}

static void set_zero(fo_real x[FO_NX])
{
    for (int i = 0; i < FO_NX; i++) {
        x[i] = ZERO;
    }
}

/* ---- configuration ------------------------------------------------------------------- */

static bool is_finite(const fo_real *x, int n)
{
    fo_real sum = ZERO;
    for (int i = 0; i < n; i++) {
        sum += x[i] - x[i];
    }
    return sum == ZERO;
}

#define DEMAND_MATRIX(name) \
    demand(&error, is_finite(&c->name[0][0], FO_N * FO_N), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_VECTOR(name) demand(&error, is_finite(c->name, FO_N), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_NUMBER(name) demand(&error, is_finite(&c->name, 1), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_FINITE(name, least, most) DEMAND_NUMBER(name)
#define PASSED_OVER(name)
#define PASSED_OVER_RANGE(name, least, most)
#define DEMAND_POSITIVE(name, least, most) \
    demand(&error, c->name > ZERO, FO_ERROR_BASE, #name);
#define DEMAND_RANGE(name, least, most)                                                    \
    demand(&error, within(c->name, (fo_real)(least), (fo_real)(most)), FO_ERROR_RANGE, #name);

#if FO_ISOTROPIC
/* Is the matrix a multiple of the identity? */
static bool is_scalar(fo_real aa, fo_real ab, fo_real ba, fo_real bb)
{
    return !(fo_abs(ab) + fo_abs(ba) + fo_abs(aa - bb) > ZERO);
}
#define DEMAND_IDENTITY(name)                                                                   \
    demand(&error, is_scalar(c->name[0][0], c->name[0][1], c->name[1][0], c->name[1][1]),       \
           FO_ERROR_OTHER, #name);
#define DEMAND_NOTHING(name) \
    demand(&error, !(fo_abs(c->name[0]) + fo_abs(c->name[1]) > ZERO), FO_ERROR_OTHER, #name);
#endif

static field_error check_config(const fo_config *c)
{
    field_error error = {FO_OK, NULL};
    FO_CONFIG_FIELDS(DEMAND_MATRIX, DEMAND_VECTOR, DEMAND_NUMBER, DEMAND_FINITE)
    demand(&error, c->sample_time > ZERO, FO_ERROR_SAMPLE_TIME, "sample_time");
    demand(&error, memory_fits(c->memory, c->sample_time), FO_ERROR_SAMPLE_TIME, "memory");
    FO_CONFIG_FIELDS(PASSED_OVER, PASSED_OVER, PASSED_OVER, DEMAND_POSITIVE)
    FO_CONFIG_FIELDS(PASSED_OVER, PASSED_OVER, PASSED_OVER, DEMAND_RANGE)
    demand(&error, c->R[0][0] >= ZERO && c->R[1][1] >= ZERO, FO_ERROR_RANGE, "R");
    /* features that fluxobs_real.h leaves out */
#if FO_ISOTROPIC
    FO_CONFIG_FIELDS(DEMAND_IDENTITY, DEMAND_NOTHING, PASSED_OVER, PASSED_OVER_RANGE)
#endif
#if !FO_HELD
    demand(&error, !(fo_abs(c->kink_now) > ZERO), FO_ERROR_OTHER, "R"); /* R h/L is large */
#endif
    return error;
}

/* Share of the prior that one re-injection restores: forgetting removes 1 - rho^period in a
 * round. */
static fo_real reinjection_share(fo_real rho)
{
    fo_real kept = ONE;
    for (int i = 0; i < (int)REINJECT_PERIOD; i++) {
        kept *= rho;
    }
    return ONE - kept;
}

/* Gains of the tracker for its pole. */
static void set_tracker(fo_observer *o, fo_real pole)
{
    const fo_real gap = ONE - pole, h = o->sample_time;
    o->track[0] = ONE - pole * pole * pole;
    o->track[1] = (fo_real)1.5 * gap * gap * (ONE + pole) / h;
    o->track[2] = gap * gap * gap / (h * h);
}

static void prepare(fo_observer *o, const fo_config *c)
{
    const fo_real psi = c->flux_base;
    const fo_real drift_base = psi / c->memory; /* the base of time is the memory */
    const fo_real drift_prior = c->drift_prior / drift_base;
    fo_real q2 = ZERO;

    for (int i = 0; i < FO_N; i++) {
        for (int j = 0; j < FO_N; j++) {
            const fo_real q1 = (c->Q1[i][j] + c->Q1[j][i]) / TWO;
            const fo_real q3 = (c->Q3[i][j] + c->Q3[j][i]) / TWO;
            o->Q1x2[i][j] = TWO * q1 * psi * psi / c->constraint_base;
            o->row_Q2[i][j] = c->Q2[i][j] * psi / c->constraint_noise;
            o->row_Q3[i][j] = q3 / c->constraint_noise;
            o->hR[i][j] = c->sample_time * c->R[i][j] / (psi * (fo_real)24);
            o->hB[i][j] = c->sample_time * c->B[i][j] / psi;
            q2 += o->row_Q2[i][j] * o->row_Q2[i][j];
        }
        o->E[i] = c->E[i] * psi / c->constraint_base;
        o->row_C[i] = c->C[i] / c->constraint_noise;
    }
    o->kink_now = c->kink_now;
    o->kink_before = c->kink_before;
    o->row_s = c->constraint_base / c->constraint_noise;
    o->sample_time = c->sample_time;
    o->h = c->sample_time / c->memory;
    o->rho = ONE - o->h;
    o->noise_information = q2 / (fo_real)FO_N * c->current_noise * c->current_noise;

    o->drift_prior_std = drift_prior;
    o->reinject = reinjection_share(o->rho);
    o->flux_base = psi;
    o->drift_base = drift_base;
    o->current_limit = c->current_limit;
    o->over_noise = ONE / ((fo_real)(20 * FO_N) * c->current_noise * c->current_noise);
    o->square_min = c->length_min * c->length_min / (psi * psi);
    o->L_position = c->L_position / psi;
    /* Noise of x due to current noise: it acts directly through L, and as a random walk of the flux
     * through R. The least squares follows that walk with about a quarter of the memory. */
    fo_real walk = ZERO;
    for (int i = 0; i < FO_N; i++) {
        walk += c->R[i][i] / (fo_real)FO_N;
    }
    walk *= walk * c->sample_time * c->memory / (fo_real)4;
    o->position_noise = (c->L_position * c->L_position + walk) * c->current_noise *
                        c->current_noise / (psi * psi);

    /* Fading-memory filter of second order with a triple pole z: it has no lag at constant
     * acceleration. 1 / (1 + x + x^2/2) replaces exp(-x), so that the core needs no exp. */
    const fo_real x = c->tracker_bandwidth * c->sample_time;
    set_tracker(o, ONE / (ONE + x + x * x / TWO));
}

/* Are the prepared numbers within the range of single precision? The limits are far beyond those of
 * any machine. */
static field_error check_prepared(const fo_observer *o)
{
    const fo_real low = (fo_real)1e-12, high = (fo_real)1e12;
    const fo_real thousand = (fo_real)1e3, million = (fo_real)1e6, most = (fo_real)1e24;
    const fo_real i = o->current_limit;
    field_error error = {FO_OK, NULL};
    demand_size(&error, o->flux_base, low, high, "flux_base");
    demand_size(&error, o->drift_base, low, high, "memory");
    demand_size(&error, o->sample_time, low, high, "sample_time");
    demand_size(&error, i, low, high, "current_limit");
    for (int n = 0; n < FO_N; n++) {
        demand_size(&error, o->E[n], -thousand, thousand, "E");
        demand_size(&error, o->row_C[n] * i, -high, high, "C");
        for (int m = 0; m < FO_N; m++) {
            demand_size(&error, o->Q1x2[n][m], -thousand, thousand, "Q1");
            demand_size(&error, o->row_Q2[n][m] * i, -(fo_real)1e9, (fo_real)1e9, "Q2");
            demand_size(&error, o->row_Q3[n][m] * i * i, -high, high, "Q3");
            demand_size(&error, o->hR[n][m] * i, -thousand, thousand, "R");
            demand_size(&error, o->hB[n][m], -high, high, "B");
        }
    }
    demand_size(&error, o->drift_prior_std, (fo_real)1e-6, million, "drift_prior");
    demand_size(&error, o->row_s, (fo_real)1e-3, million, "constraint_noise");
    demand_size(&error, o->kink_now, -ONE, ONE, "kink_now");
    demand_size(&error, o->kink_before, -ONE, ONE, "kink_before");
    demand_size(&error, o->L_position * i, -million, million, "L_position");
    demand_size(&error, o->square_min, ZERO, million, "length_min");
    demand_size(&error, o->position_noise, ZERO, million, "current_noise");
    demand_size(&error, o->noise_information, ZERO, high, "current_noise");
    demand_size(&error, o->over_noise * i * i, ZERO, most, "current_noise");
    demand_size(&error, o->track[2], ZERO, most, "tracker_bandwidth");
    return error;
}

static field_error prepare_checked(fo_observer *o, const fo_config *c)
{
    field_error error = check_config(c);
    if (error.code == FO_OK) {
        prepare(o, c);
#if FO_MAPPED
        o->map = NULL;
#endif
        error = check_prepared(o);
    }
    return error;
}

fo_error fo_init(fo_observer *o, const fo_config *c) { return prepare_checked(o, c).code; }

const char *fo_wrong(const fo_config *c)
{
    fo_observer o;
    return prepare_checked(&o, c).field;
}

#if FO_MAPPED
fo_error fo_use_map(fo_observer *o, const fo_map *map)
{
    const bool good = fo_map_good(map);
    o->map = good ? map : NULL;
    return good ? FO_OK : FO_ERROR_RANGE;
}
#endif

/* ---- square-root information filter -------------------------------------------------- */

/* Prior information on element i of the state. */
static fo_real prior_information(const fo_state *s, int i)
{
    fo_real information = i < KAPPA ? ONE : s->drift_prior;
    if (i == KAPPA) {
        information /= (fo_real)4; /* kappa = 2 drift'Q1 flux has twice the drift's std */
    }
    if (i == CC) {
        information *= information;
    }
    return information;
}

/* Resets the information to the prior, and the power of the innovations to the assumed power. */
static void reset_information(fo_state *s)
{
    (void)memset(&s->info, 0, sizeof s->info);
    set_zero(s->x);
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] = prior_information(s, i);
    }
    s->innovation = ZERO;
    s->power = ONE;
    s->lag_one = ZERO;
    s->noise_share = ONE;
    s->rotation = ZERO;
    s->trusted = false;
    s->round_index = 0U;
}

static void restart(fo_state *s)
{
    reset_information(s);
    s->have_current = false;
    s->have_voltage = false;
    s->variance = VARIANCE_UNKNOWN; /* the integrated flux is lost */
}

void fo_reset(const fo_observer *o, fo_state *s)
{
    (void)memset(s, 0, sizeof *s);
    s->drift_prior = ONE / (o->drift_prior_std * o->drift_prior_std);
    s->noise_inflation = ONE;
    restart(s);
}

/* Zero if x is finite, else NaN. */
static inline fo_real zero_if_finite(fo_real x) { return x - x; }

/* Checks that the weights of a state are positive, and that its noises are finite and no larger
 * than the inputs allow. The recursion would keep any other number, and the observer would stay
 * invalid without a restart. The other numbers of a state are replaced within a few samples. */
bool fo_damaged(const fo_observer *o, const fo_state *s)
{
    bool damaged = is_never_reset(s);
    if (!damaged) {
        const fo_tracker *t = &s->tracker;
        fo_real sum = zero_if_finite(s->power) + zero_if_finite(s->lag_one) +
                      zero_if_finite(s->rotation) + zero_if_finite(t->angle) +
                      zero_if_finite(t->speed) + zero_if_finite(t->acceleration) +
                      zero_if_finite(t->settled);
        for (int i = 0; i < FO_NX; i++) {
            sum += zero_if_finite(s->info.d[i]);
            damaged = damaged || !(s->info.d[i] > ZERO);
        }
        for (int i = 0; i < 3; i++) {
            sum += zero_if_finite(s->info.noise[i]);
        }
        /* Largest third difference of currents, and largest drift with a widened prior. */
        const fo_real current_max = (fo_real)16 * o->current_limit;
        const fo_real ratio_max = ONE + current_max * current_max * o->over_noise;
        const fo_real drift = WIDEN * FLUX_STEP_LIMIT, least = s->drift_prior * drift * drift;
        damaged = damaged || sum != ZERO ||
                  !within(s->noise_ratio, ZERO, ratio_max) ||
                  !within(s->noise_ratio_without_ripple, ZERO, ratio_max) ||
                  !(s->info.noise[0] * o->h <= TWO * o->noise_information * ratio_max) ||
                  !(least >= o->h * o->h) ||
                  !(s->drift_prior * o->drift_prior_std * o->drift_prior_std <= TWO);
    }
    return damaged;
}

/* Adds row'x = value. Elements of row before `first` must be zero. Returns the normalised
 * innovation. */
static inline fo_real add_row(fo_information *info, fo_real row[FO_NX], fo_real value,
                                fo_real information, int first)
{
    measurement m = {value, information};
#if FO_WRITTEN_OUT
    if (first == (int)S) {
        FO_UNROLL
        for (int i = 0; i < FO_NX; i++) {
            rotate_row(info, i, row, &m);
        }
    } else
#endif
    {
        for (int i = first; i < FO_NX; i++) {
            rotate_row(info, i, row, &m);
        }
    }
    return fo_sqrt(m.weight) * m.rhs;
}

fo_real fo_add_row(fo_information *info, fo_real row[FO_NX], fo_real value, fo_real information,
                     int first)
{
    return add_row(info, row, value, information, first);
}

/* ---- measurement ---------------------------------------------------------------------- */

#if FO_MAPPED
/* Turns v from the frame with d axis `direction` to alpha, beta. */
static void rotate_vector(const fo_real v[FO_N], const fo_real direction[FO_N],
                          fo_real turned[FO_N]) {
    turned[0] = direction[0] * v[0] - direction[1] * v[1];
    turned[1] = direction[1] * v[0] + direction[0] * v[1];
}

/* Predicts a cage's rotor flux from i_d. Its magnetizing current follows d(magnetizing)/dt = (i_d -
 * magnetizing) R_R / L_M, and the flux is proportional to this current. Small differences have
 * little weight, because a current offset makes i_d ripple. */
static void predict_rotor_flux(const fo_observer *o, const fo_state *s, fo_real i_d,
                               fo_map_point *f) {
    const fo_map *map = o->map;
    const fo_map_point *b = &s->previous_point;
    f->rotor_flux = b->rotor_flux;
    f->square = b->square;
    const bool known = s->trusted || s->has_external_angle;
    f->magnetizing_current = known ? b->magnetizing_current : ZERO;
    if (f->magnetizing_current > map->still) {
        const fo_real difference = i_d - f->magnetizing_current;
        const fo_real square = difference * difference;
        const fo_real growth =
            map->decay * difference * square / (square + map->still * map->still);
        const fo_real ratio = growth / f->magnetizing_current;
        f->magnetizing_current += growth;
        f->rotor_flux += ratio * s->length;
        f->square += TWO * ratio * s->length * s->length;
    } else if (known) {
        f->magnetizing_current = i_d;
    } else {
        /* the angle is unknown */
    }
}

/* The current in the frame of a rotor with this direction. */
static void to_rotor_frame(const fo_real direction[FO_N], const fo_real current[FO_N],
                           fo_real i[FO_N]) {
    const fo_real back[FO_N] = {direction[0], -direction[1]};
    rotate_vector(current, back, i);
}

void fo_linearise_map(const fo_observer *o, fo_real angle, const fo_real current[FO_N],
                      fo_map_point *f) {
    const fo_map *map = o->map;
    const fo_real over = ONE / o->flux_base;
    fo_real direction[FO_N], i[FO_N];
    fo_mapped answer;
    fo_direction(angle, direction);
    to_rotor_frame(direction, current, i);
    fo_map_at(map, i, f->rotor_flux * o->flux_base, &answer);
    /* The relation holds for any share of the auxiliary flux. The share 1/2 needs no angle if the
     * machine is linear and has no magnets; the share 1 needs no angle if the machine has no
     * saliency. */
    const fo_real share = map->magnets ? ONE : ONE / TWO;
    const fo_real psi = map->psi * over;
    const fo_real a_d = answer.auxiliary[0] * over, a_q = answer.auxiliary[1] * over;
    const fo_real slope = fo_abs(a_d) > ACTIVE_FLUX_MIN ? a_q / a_d : ZERO;
    const fo_real armature[FO_N] = {answer.flux[0] * over - a_d, answer.flux[1] * over};
    const fo_real centre[FO_N] = {answer.flux[0] * over - share * a_d,
                                  answer.flux[1] * over - share * a_q};
    const fo_real by_flux[FO_N] = {ONE, slope};
    const fo_real by_current[FO_N] = {(answer.by_d[0] + slope * answer.by_d[1]) * over,
                                      (answer.by_q[0] + slope * answer.by_q[1]) * over};
    f->direction[0] = direction[0];
    f->direction[1] = direction[1];
    rotate_vector(armature, direction, f->armature_flux);
    rotate_vector(centre, direction, f->centre);
    rotate_vector(by_flux, direction, f->by_flux);
    rotate_vector(by_current, direction, f->by_current);
    f->active_flux = map->kind == FO_MAP_CAGE ? a_d : fo_abs(a_d);
    f->outside = answer.outside;
    if (map->kind != FO_MAP_CAGE) {
        f->square = share * share * (a_d * a_d + a_q * a_q) - psi * psi;
    }
}

/* Linearises the map at the newest current and at the tracker's predicted angle. */
static void linearise_map(const fo_observer *o, fo_state *s)
{
    fo_map_point *f = &s->map_point;
    const fo_real *current = s->current[0];
    if (has_map(o)) {
        const fo_real angle =
            s->has_external_angle ? s->external_angle : predicted_angle(o, &s->tracker);
        if (o->map->kind == FO_MAP_CAGE) {
            fo_real direction[FO_N], i[FO_N];
            fo_direction(angle, direction);
            to_rotor_frame(direction, current, i);
            predict_rotor_flux(o, s, i[0], f);
        }
        fo_linearise_map(o, angle, current, f);
    } else {
        for (int i = 0; i < FO_N; i++) {
            f->armature_flux[i] = o->L_position * current[i];
        }
    }
}
#endif

/* Measurement row 0 = s + (Q2 i)'flux + i'Q3 i + C'i, divided by its noise. With a map: 0 = s - 2
 * centre'flux + |centre|^2 - square. Returns the right-hand side of row'x = rhs. */
static fo_real measurement_row(const fo_observer *o, const fo_state *s, fo_real row[FO_NX])
{
    const fo_real *current = s->current[0];
    fo_real rhs = ZERO;
    set_zero(row);
    row[S] = o->row_s;
#if FO_MAPPED
    if (has_map(o)) {
        const fo_map_point *f = &s->map_point;
        for (int i = 0; i < FO_N; i++) {
            row[FLUX + i] = -TWO * o->row_s * f->centre[i];
        }
        rhs = o->row_s * (f->square - dot(f->centre, f->centre));
    } else
#endif
    {
        for (int i = 0; i < FO_N; i++) {
            row[FLUX + i] = row_of(o->row_Q2, i, current);
            rhs -= current[i] * add_linear(row_of(o->row_Q3, i, current), o->row_C[i]);
        }
    }
    return rhs;
}

/* Is the innovation against a prediction from the last estimate larger than any noise? */
static bool is_outlier(const fo_observer *o, const fo_state *s, const interval *t,
                        const fo_real row[FO_NX], fo_real rhs)
{
    const fo_real h = o->h, *x = s->x;
    fo_real innovation = rhs;
    fo_real s_predicted = x[S] + t->input + h * (x[KAPPA] + h * x[CC]);
    for (int i = 0; i < FO_N; i++) {
        const fo_real flux = x[FLUX + i] + h * x[DRIFT + i];
        s_predicted += t->q[i] * flux;
        innovation -= row[FLUX + i] * (flux + t->v[i]);
    }
    innovation -= row[S] * s_predicted;
    return !(fo_abs(innovation) < OUTLIER_LIMIT * row[S]);
}

/* Measurement update by row'x = rhs. Updates the power of the innovations and the current noise. */
static void update_measurement(const fo_observer *o, fo_state *s, fo_real row[FO_NX], fo_real rhs)
{
    const fo_real e = add_row(&s->info, row, rhs, ONE, S);
    const fo_real third[FO_N] = {third_difference(s->current[0][0], s->current[1][0],
                                                  s->current[2][0], s->current[3][0]),
                                 third_difference(s->current[0][1], s->current[1][1],
                                                  s->current[2][1], s->current[3][1])};
    const fo_real sums[FO_N] = {difference_of_sums(s->current[0][0], s->current[1][0],
                                                   s->current[2][0], s->current[3][0]),
                                difference_of_sums(s->current[0][1], s->current[1][1],
                                                   s->current[2][1], s->current[3][1])};
    const fo_real share = o->h * e;
    s->power = o->rho * s->power + share * e;
    s->lag_one = o->rho * s->lag_one + share * s->innovation;
    s->innovation = e;
    s->info.noise[0] += o->noise_information * s->noise_inflation;
    s->noise_ratio += o->h * (dot(third, third) * o->over_noise - s->noise_ratio);
    s->noise_ratio_without_ripple +=
        o->h * ((fo_real)5 * dot(sums, sums) * o->over_noise - s->noise_ratio_without_ripple);
    const fo_real least = s->noise_ratio < s->noise_ratio_without_ripple
                              ? s->noise_ratio : s->noise_ratio_without_ripple;
    s->noise_inflation = least > ONE ? least : ONE;
}

/* ---- certainty ------------------------------------------------------------------------ */

/* Computes the position vector x = flux - L i; returns |x|^2. */
static fo_real position_vector(const fo_observer *o, const fo_state *s, const fo_real flux[FO_N],
                        fo_real p[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        p[i] = flux[i] - armature_flux(o, s, i);
    }
    return dot(p, p);
}

/* Multiplies all information by this factor, which is below one. */
static void discount_information(fo_state *s, fo_real factor)
{
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] *= factor;
    }
    for (int i = 0; i < 3; i++) {
        s->info.noise[i] *= factor;
    }
}

/* Widens a drift prior that proved too tight. Discounts the information gathered with that prior,
 * because forgetting alone would remove its effect slowly. */
static void widen_drift_prior(fo_state *s, fo_real excess)
{
    s->drift_prior /= WIDEN * excess;
    discount_information(s, DISTRUST / excess);
}

/* Updates the variance of the angle of the position vector p, and the share of noise in the flux
 * information. */
static void update_variances(fo_state *s, const fo_real p[FO_N], fo_real square)
{
    /* A too tight drift prior makes the covariance too small by this factor. */
    const fo_real *drift = &s->x[DRIFT];
    const fo_real excess = dot(drift, drift) * s->drift_prior;
    const variances flux = flux_variances(&s->info, p);
    const fo_real across = flux.across / square, along = flux.along / square;
    /* Information on the flux from noise alone, after elimination of the drift. */
    const fo_real *noise = s->info.noise;
    const fo_real shared = noise[2] > ZERO ? noise[1] * noise[1] / noise[2] : ZERO;
    s->noise_share = (noise[0] - shared) * (across + along);
    /* The variance increases with the correlation of the innovations and with the ratio of their
     * power to the assumed power. */
    const fo_real r = correlation(s->lag_one, s->power);
    s->inflation = s->power * (ONE + r) / (ONE - r);
    s->angle_variance = s->inflation * across / square;
    if (excess > ONE) {
        s->angle_variance *= excess;
        if (s->trusted && fo_abs(s->rotation) > SETTLED) {
            widen_drift_prior(s, excess);
        }
    }
}

/* Re-injects one row of the prior, centred on the estimate. This bounds the standard deviations and
 * does not move the estimate. */
static void reinject_prior(const fo_observer *o, fo_state *s, int i)
{
    fo_real row[FO_NX];
    set_zero(row);
    row[i] = ONE;
    (void)add_row(&s->info, row, s->x[i], o->reinject * prior_information(s, i), i);
}

/* Integrates the last trusted flux in open loop; returns the variance of its angle. The variance
 * grows with the uncertainty of the drift, with a voltage error of the drift's prior std, and with
 * changes of the position vector's length, which should be constant. When the angle has become
 * unknown, the flux is no longer integrated. */
static fo_real integrate_open_loop(const fo_observer *o, fo_state *s, const fo_real v[FO_N])
{
    fo_real p[FO_N], flux[FO_N];
    if (s->open_loop_time == ZERO) {
        const fo_real square = position_vector(o, s, s->flux, p);
        const fo_real across = drift_variance_across(&s->info, p) / square;
        s->variance_growth =
            (s->inflation * across + o->drift_prior_std * o->drift_prior_std) / square;
        s->open_loop_length = fo_sqrt(square);
#if FO_MAPPED
        s->open_loop_length -= has_map(o) ? s->map_point.active_flux : ZERO;
#endif
        s->open_loop_error = ZERO;
    }
    s->open_loop_time += o->h;
    for (int i = 0; i < FO_N; i++) {
        flux[i] = s->flux[i] + v[i] + o->h * s->drift[i];
    }
    fo_real expected = s->open_loop_length;
#if FO_MAPPED
    if (has_map(o)) { /* the map gives the present length */
        expected += s->map_point.active_flux;
        expected = expected > ACTIVE_FLUX_MIN ? expected : ACTIVE_FLUX_MIN;
    }
#endif
    const fo_real change = fo_sqrt(position_vector(o, s, flux, p)) / expected - ONE;
    s->open_loop_error =
        change * change > s->open_loop_error ? change * change : s->open_loop_error;
    const fo_real variance = s->variance +
                             s->variance_growth * s->open_loop_time * s->open_loop_time +
                             s->open_loop_error;
    if (variance < VARIANCE_UNKNOWN) {
        s->flux[0] = flux[0];
        s->flux[1] = flux[1];
    }
    return variance;
}

/* ---- estimate ------------------------------------------------------------------------- */

/* Flux, drift and position vector that a sample reports. */
typedef struct {
    const fo_real *flux, *drift;
    fo_real theta, square; /* angle and square of the position vector */
    fo_real variance;      /* variance of the angle                   */
} solution;

/* Solves for the state. Resets the information if the numbers have diverged, as after a long
 * standstill. */
static void solve_state(const fo_observer *o, fo_state *s, fo_real p[FO_N], solution *r)
{
    solve(&s->info, s->x);
    r->flux = &s->x[FLUX];
    r->drift = &s->x[DRIFT];
    r->square = position_vector(o, s, r->flux, p);
    if (!(r->square < RUNAWAY)) { /* also true for NaN */
        s->restarts++;
        reset_information(s);
        r->square = position_vector(o, s, r->flux, p);
    }
    r->theta = fo_atan2(p[1], p[0]);
}

/* Does the work of this sample in its round: re-injects a row of the prior, or updates the
 * variances. */
static void take_turn(const fo_observer *o, fo_state *s, const fo_real p[FO_N], fo_real square)
{
    if ((s->round_index & 1U) == 0U) {
        reinject_prior(o, s, (int)s->round_index / 2);
    } else if (square > o->square_min) {
        update_variances(s, p, square);
    } else {
        s->noise_share = ONE;
    }
    s->round_index = s->round_index + 1U < (uint32_t)REINJECT_PERIOD ? s->round_index + 1U : 0U;
}

/* Updates the turn of the flux by a voltage error as large as the drift's prior std. The turn
 * accumulates until the rotor has turned by about a radian. The turn is bounded, so that a stop
 * does not count for long afterwards. */
static void update_voltage_turn(const fo_observer *o, fo_state *s)
{
    const fo_real turned = fo_abs(s->tracker.speed) * o->sample_time;
    s->voltage_turn += o->h * o->drift_prior_std - s->voltage_turn * (turned < ONE ? turned : ONE);
    s->voltage_turn = s->voltage_turn < VOLTAGE_TURN_MAX ? s->voltage_turn : VOLTAGE_TURN_MAX;
}

/* Selects the flux to report: the flux of the least squares if it is trusted or no better flux is
 * known, else the integral of the last trusted flux. See docs/theory.md, section 6. */
static void select_flux(const fo_observer *o, fo_state *s, const fo_real v[FO_N], bool known,
                        bool trusted, solution *r)
{
    r->variance = VARIANCE_UNKNOWN;
    if (trusted) {
        r->variance = s->angle_variance + o->position_noise * s->noise_inflation / r->square +
                      cage_ripple_variance(o, s->tracker.speed);
        s->variance = r->variance;
        s->open_loop_time = ZERO;
        s->have_trusted_flux = true;
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] = r->flux[i];
            s->drift[i] = r->drift[i];
        }
    } else if (s->have_trusted_flux) {
        r->variance = integrate_open_loop(o, s, v);
        if (!known || r->variance < VARIANCE_UNKNOWN) {
            fo_real p[FO_N];
            r->flux = s->flux;
            r->drift = s->drift;
            r->square = position_vector(o, s, r->flux, p);
            r->theta = fo_atan2(p[1], p[0]);
        }
    } else {
        /* nothing better is known */
    }
}

/* Tracks the reported angle. If the angle is unknown, the tracker stops. */
static void track_solution(const fo_observer *o, fo_state *s, bool known, solution *r)
{
    const bool lost = !(r->variance >= ZERO && r->variance < VARIANCE_UNKNOWN);
    if (lost) {
        r->variance = VARIANCE_UNKNOWN;
    }
    if (lost && !known) {
        stop_tracker(&s->tracker, r->theta);
    } else {
        track(o, &s->tracker, r->theta);
    }
    s->length = fo_sqrt(r->square);
}

#if FO_MAPPED
/* Stores the map's linearisation for the next sample. */
static void finish_map(const fo_observer *o, fo_state *s, bool trusted)
{
    if (has_map(o)) {
        if (trusted && !s->trusted) {
            discount_information(s, DISTRUST); /* earlier rows were linearised at wrong angles */
        }
        s->previous_point = s->map_point;
        s->outside += trusted && s->map_point.outside ? 1U : 0U;
    }
}
#endif

/* Why the position is not valid. */
static fo_reason judge(const fo_observer *o, const fo_state *s, const solution *r)
{
    fo_reason reason = FO_VALID;
    if (!(s->have_current && s->have_voltage)) {
        reason = FO_NO_DATA;
    } else if (!s->trusted) {
        reason = FO_SEARCHING;
    } else if (!(s->tracker.settled >= TRACKER_SETTLED)) {
        reason = FO_SETTLING;
    } else if (!(s->voltage_turn < VOLTAGE_LIMIT * s->length)) {
        /* the innovations do not show the slow turn by a voltage error of plausible size */
        reason = FO_SLOW;
    } else if (!(r->variance < STD_LIMIT * STD_LIMIT)) {
        reason = FO_UNCERTAIN;
    } else {
#if FO_MAPPED
        /* the map was linearised at the tracker's predicted angle */
        const bool near = fo_abs(wrap(r->theta - s->tracker.angle)) < STD_LIMIT;
        if (has_map(o) && (s->map_point.outside || !near)) {
            reason = FO_OUTSIDE_MAP;
        }
#else
        (void)o;
#endif
    }
    return reason;
}

/* Writes the estimate of a sample, and whether its position is valid. */
static void write_estimate(const fo_observer *o, const fo_state *s, const solution *r,
                           fo_estimate *e)
{
    for (int i = 0; i < FO_N; i++) {
        e->flux[i] = r->flux[i] * o->flux_base;
        e->drift[i] = r->drift[i] * o->drift_base;
    }
    e->psi_f = s->length * o->flux_base;
    e->theta_e = r->theta;
    e->theta_e_tracked = s->tracker.angle;
    e->speed_e = s->tracker.speed;
    e->innovation = s->innovation;
    e->noise_share = s->noise_share;
    set_reason(e, judge(o, s, r));
}

/* Makes the estimate after a sample with the volt-seconds v. */
static void finish_estimate(const fo_observer *o, fo_state *s, const fo_real v[FO_N],
                            fo_estimate *e) {
    fo_real p[FO_N];
    solution r;
    solve_state(o, s, p, &r);
    const bool long_enough = r.square > o->square_min;
    take_turn(o, s, p, r.square);
    const bool known = long_enough && s->noise_share < SHARE_LIMIT;
    s->rotation = known ? s->rotation + wrap(r.theta - s->theta) : ZERO;
    s->theta = r.theta;
    const bool trusted = known && (s->trusted || fo_abs(s->rotation) > SWEEP);
    update_voltage_turn(o, s);
    select_flux(o, s, v, known, trusted, &r);
    track_solution(o, s, known, &r);
#if FO_MAPPED
    finish_map(o, s, trusted);
#endif
    s->trusted = trusted;
    e->theta_e_std = fo_sqrt(r.variance);
    if (trusted) {
        settle_tracker(o, &s->tracker, r.theta, e->theta_e_std);
    } else {
        s->tracker.settled = ZERO;
    }
    write_estimate(o, s, &r, e);
}

/* ---- samples -------------------------------------------------------------------------- */

/* Integrates the last interval. Subtracts the resistive drop, unless the volt-seconds are
 * `complete`. Returns the interval since the last row, which may consist of two. */
static void integrate_interval(const fo_observer *o, fo_state *s, bool complete,
                               const fo_merged *merged, interval *t)
{
    fo_real mean[FO_N] = {0};
    for (int i = 0; i < FO_N && !complete; i++) {
        mean[i] = mean_current_24(s->current[0][i], s->current[1][i], s->current[2][i],
                                  s->current[3][i]);
    }
    for (int i = 0; i < FO_N; i++) {
        s->volt_seconds[i] = s->source[i] - row_of(o->hR, i, mean);
        t->v[i] = s->volt_seconds[i];
    }
    if (merged != NULL && merged->pending) {
        for (int i = 0; i < FO_N; i++) {
            t->v[i] += merged->volt_seconds[i];
        }
    }
    for (int i = 0; i < FO_N; i++) {
        t->q[i] = row_of(o->Q1x2, i, t->v);
    }
    t->input = add_linear(dot(t->q, t->v) / TWO, dot(o->E, t->v));
}

/* Length of the position vector's step over the interval; the drift is negligible. */
static fo_real position_step_length(const fo_observer *o, const fo_state *s)
{
    const fo_real *v = s->volt_seconds;
    fo_real step[FO_N];
    for (int i = 0; i < FO_N; i++) {
        step[i] = v[i] - o->L_position * (s->current[0][i] - s->current[1][i]);
#if FO_MAPPED
        if (has_map(o)) {
            step[i] = v[i] - (s->map_point.armature_flux[i] - s->previous_point.armature_flux[i]);
        }
#endif
    }
    return fo_sqrt(dot(step, step));
}

/* Is the position vector's step longer than motion and noise explain? */
static bool position_jumps(const fo_observer *o, const fo_state *s, fo_real step)
{
    return step > TWO * s->step + STEP_LIMIT * s->length +
                      STEP_NOISE * fo_sqrt(o->position_noise * s->noise_inflation);
}

/* Measurement row of the newest current; a map is linearised at that current. */
static fo_real row_of_newest_current(const fo_observer *o, fo_state *s, fo_real row[FO_NX])
{
#if FO_MAPPED
    linearise_map(o, s);
#endif
    return measurement_row(o, s, row);
}

static void push_current(fo_state *s, fo_real i0, fo_real i1)
{
    for (int k = FO_HISTORY - 1; k > 0; k--) {
        s->current[k][0] = s->current[k - 1][0];
        s->current[k][1] = s->current[k - 1][1];
    }
    s->current[0][0] = i0;
    s->current[0][1] = i1;
}

/* Predicts a missing vector. If the rotor's speed is known, the vector turns with the rotor:
 * tan(angle / 2) = speed * sample_time / 2. */
static void extrapolate(const fo_observer *o, const fo_state *s, const fo_real before[FO_N],
                  fo_real now[FO_N])
{
    const fo_real half = s->trusted ? s->tracker.speed * o->sample_time / TWO : ZERO;
    const fo_real over = ONE / (ONE + half * half);
    const fo_real cosine = (ONE - half * half) * over, sine = TWO * half * over;
    const fo_real alpha = before[0], beta = before[1];
    now[0] = cosine * alpha - sine * beta;
    now[1] = sine * alpha + cosine * beta;
}

typedef enum { GOOD, MISSING, ABSURD } sample_quality;

static sample_quality classify(const fo_real x[FO_N], fo_real limit)
{
    sample_quality quality = GOOD;
    if (!(dot(x, x) <= limit * limit)) { /* x - x is not 0 where x is not finite */
        quality = (x[0] - x[0]) + (x[1] - x[1]) == ZERO ? ABSURD : MISSING;
    }
    return quality;
}

/* Processes one sample. `source` is in per-unit volt-seconds, either `complete` or still without
 * the resistive drop. `rows` is the observer with the time of a row: o, or that of two samples if
 * an interval is pending. A sample that `begins` a merged interval has no row, and no
 * estimate unless the observer restarts. */
static void process_sample(const fo_observer *o, const fo_observer *rows, fo_state *s,
                           fo_merged *merged, bool begins, const fo_real source[FO_N],
                           bool complete, const fo_real current[FO_N], fo_estimate *e)
{
    interval t = {{ZERO, ZERO}, {ZERO, ZERO}, ZERO};
    if (may_be_damaged(s) && fo_damaged(o, s)) {
        const uint32_t restarts = s->restarts;
        fo_reset(o, s);
        s->restarts = restarts + 1U;
    }
    const sample_quality of_source = classify(source, FLUX_STEP_LIMIT);
    const sample_quality of_current = classify(current, o->current_limit);
    const bool absurd = of_source == ABSURD || of_current == ABSURD;
    bool measured = of_current == GOOD, bad = of_current == MISSING;

    if (bad) {
        s->bad_currents++;
    }
    if (of_source == MISSING && (s->have_voltage || s->restarts > 0U)) { /* not before the first */
        s->bad_voltages++;
        bad = bad || s->have_voltage;
    }
    if (absurd) {
        s->absurd++;
    }

    if (!absurd && (measured || s->have_current)) {
        fo_real row[FO_NX], newest[FO_N] = {current[0], current[1]};
        if (!measured) {
            extrapolate(o, s, s->current[0], newest);
        }
        for (int times = s->have_current ? 1 : (int)FO_HISTORY; times > 0; times--) {
            push_current(s, newest[0], newest[1]);
        }
        if (of_source == GOOD && s->have_current) {
            s->have_voltage = true;
            s->source[0] = source[0];
            s->source[1] = source[1];
        } else {
            extrapolate(o, s, s->source, s->source);
        }
        s->have_current = true;
        const fo_real rhs = row_of_newest_current(rows, s, row);
        if (s->have_voltage) {
            integrate_interval(o, s, complete, merged, &t);
            const fo_real step = position_step_length(o, s);
            if (measured && s->trusted &&
                (position_jumps(o, s, step) || is_outlier(rows, s, &t, row, rhs))) {
                s->outliers++; /* treat this current as missing */
                measured = false;
                bad = true;
                extrapolate(o, s, s->current[1], s->current[0]);
                (void)row_of_newest_current(rows, s, row);
                integrate_interval(o, s, complete, merged, &t);
            } else {
                s->step = step;
            }
            if (!begins) {
                predict(rows, &s->info, &t);
            }
        } else {
            reset_information(s); /* no voltage connects the past to this sample */
        }
        if (measured && !begins) {
            update_measurement(rows, s, row, rhs);
        }
    }
    s->consecutive_bad = bad ? s->consecutive_bad + 1U : 0U;
    if (absurd || (s->have_current && s->consecutive_bad > (uint32_t)FO_MAX_CONSECUTIVE_BAD)) {
        s->restarts++;
        restart(s);
    }
    const bool pending = begins && s->have_voltage; /* false: restarted */
    if (merged != NULL) {
        merged->pending = pending;
        merged->volt_seconds[0] = t.v[0];
        merged->volt_seconds[1] = t.v[1];
    }
    if (pending) {
#if FO_MAPPED
        s->previous_point = s->map_point;
#endif
    } else {
        finish_estimate(rows, s, t.v, e);
        if (e->valid && bad) {
            set_reason(e, FO_BAD_SAMPLE);
        }
    }
}

#if FO_HELD
/* A voltage that is held over the sample changes in steps, and each step puts a kink into the
 * current. The cubic through the current samples misses the kink: this subtracts the kink's part of
 * the resistive drop. */
static void subtract_kinks(const fo_observer *o, fo_state *s, fo_real source[FO_N])
{
    const bool good = classify(source, FLUX_STEP_LIMIT) == GOOD;
    for (int i = 0; i < FO_N && good; i++) {
        const fo_real held = source[i], before = s->have_voltage ? s->source_step[i] : ZERO;
        s->source_step[i] = s->have_voltage ? held - s->held_source[i] : ZERO;
        s->held_source[i] = held;
        source[i] = held - o->kink_now * s->source_step[i] - o->kink_before * before;
    }
}
#endif

void fo_step_merged(const fo_observer *o, const fo_observer *rows, fo_state *s, fo_merged *merged,
                    bool begins, const fo_real input[FO_N], bool complete,
                    const fo_real current[FO_N], fo_estimate *e)
{
    fo_real source[FO_N];
    for (int i = 0; i < FO_N; i++) {
        source[i] = complete ? input[i] / o->flux_base : row_of(o->hB, i, input);
    }
#if FO_HELD
    if (!complete && o->kink_now != ZERO) {
        subtract_kinks(o, s, source);
    }
#endif
    process_sample(o, rows, s, merged, begins, source, complete, current, e);
}

void fo_step(const fo_observer *o, fo_state *s, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *e)
{
    fo_step_merged(o, o, s, NULL, false, voltage, false, current, e);
}

void fo_step_volt_seconds(const fo_observer *o, fo_state *s, const fo_real volt_seconds[FO_N],
                          const fo_real current[FO_N], fo_estimate *e)
{
    fo_step_merged(o, o, s, NULL, false, volt_seconds, true, current, e);
}

void fo_gather(const fo_observer *o, fo_gathered *g, fo_real share, const fo_real voltage[FO_N],
               const fo_real current[FO_N])
{
    const fo_real scale = share * o->flux_base;
    fo_real mean[FO_N]; /* 24 times the mean current by the trapezoid rule, as intervals are
                         * short */
    for (int i = 0; i < FO_N; i++) {
        mean[i] = (fo_real)12 * (g->current[i] + current[i]);
        g->current[i] = current[i];
    }
    for (int i = 0; i < FO_N; i++) {
        g->volt_seconds[i] += scale * (row_of(o->hB, i, voltage) - row_of(o->hR, i, mean));
    }
}

/* Returns the observer for this sample time [s], which must be plausible. */
void fo_scale_to_duration(const fo_observer *o, fo_real duration, fo_observer *scaled)
{
    const fo_real ratio = duration / o->sample_time;
    /* The tracker's pole p follows from its gains: 1.5 h track[2] / track[1] = (1 - p) / (1 + p).
     * The bandwidth stays the same: 1/p - 1 is proportional to the duration, to first order. */
    const fo_real q = o->track[1] > ZERO
                          ? (fo_real)1.5 * o->sample_time * o->track[2] / o->track[1] : ZERO;
    const fo_real over = q < ONE ? TWO * q / (ONE - q) : (fo_real)1e6; /* 1/p - 1 */
    *scaled = *o;
    scaled->sample_time = duration;
    scaled->h = o->h * ratio;
    scaled->rho = ONE - scaled->h;
    scaled->reinject = reinjection_share(scaled->rho);
    for (int i = 0; i < FO_N; i++) {
        for (int j = 0; j < FO_N; j++) {
            scaled->hR[i][j] = o->hR[i][j] * ratio;
            scaled->hB[i][j] = o->hB[i][j] * ratio;
        }
    }
    set_tracker(scaled, ONE / (ONE + over * ratio));
}

void fo_uneven(const fo_observer *o, const fo_state *s, fo_real duration,
               const fo_real voltage[FO_N], const fo_real current[FO_N], fo_observer *now,
               fo_gathered *g)
{
    const bool plausible =
        within(duration, o->sample_time / (fo_real)10, o->sample_time * (fo_real)10);
    fo_scale_to_duration(o, plausible ? duration : o->sample_time, now);
    for (int i = 0; i < FO_N; i++) {
        g->volt_seconds[i] = ZERO;
        g->current[i] = s->current[0][i];
    }
    fo_gather(now, g, ONE, voltage, current);
    if (!plausible) {
        g->current[0] = TWO * o->current_limit; /* absurd */
    }
}

void fo_step_for(const fo_observer *o, fo_state *s, fo_real duration, const fo_real voltage[FO_N],
                 const fo_real current[FO_N], fo_estimate *e)
{
    fo_observer now;
    fo_gathered g;
    fo_uneven(o, s, duration, voltage, current, &now, &g);
    fo_step_volt_seconds(&now, s, g.volt_seconds, g.current, e);
}
