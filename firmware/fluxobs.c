/* SPDX-License-Identifier: MIT */
#include "fluxobs_internal.h"

#include <string.h>

/* Where speed is wanted, loops of few turns are written out, so that a row stays in registers:
 * not in code for size, nor where each operation calls the emulation of a floating-point unit.
 * -DFO_WRITTEN_OUT overrules it; the numbers are the same. */
#ifndef FO_WRITTEN_OUT
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__) && !defined(__SOFTFP__) && !defined(__AVR__)
#define FO_WRITTEN_OUT 1
#else
#define FO_WRITTEN_OUT 0
#endif
#endif
#if FO_WRITTEN_OUT
#define FO_UNROLL _Pragma("GCC unroll 8")
#else
#define FO_UNROLL
#endif

/* Element (i, j), i < j, of a packed strict upper triangle. */
#define AT(i, j) ((int)(i) * (2 * (int)FO_NX - (int)(i) - 3) / 2 + (int)(j) - 1)

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
    } else { /* near the axis */
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

static void clear(fo_real x[FO_NX])
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
    demand(&found, is_finite(&c->name[0][0], FO_N * FO_N), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_VECTOR(name) demand(&found, is_finite(c->name, FO_N), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_NUMBER(name) demand(&found, is_finite(&c->name, 1), FO_ERROR_NOT_FINITE, #name);
#define DEMAND_FINITE(name, least, most) DEMAND_NUMBER(name)
#define PASSED_OVER(name)
#define PASSED_OVER_RANGE(name, least, most)
#define DEMAND_POSITIVE(name, least, most) \
    demand(&found, c->name > ZERO, FO_ERROR_BASE, #name);
#define DEMAND_RANGE(name, least, most)                                                    \
    demand(&found, within(c->name, (fo_real)(least), (fo_real)(most)), FO_ERROR_RANGE, #name);

#if FO_ISOTROPIC
/* Is it a number times the identity? */
static bool is_number(fo_real aa, fo_real ab, fo_real ba, fo_real bb)
{
    return !(fo_abs(ab) + fo_abs(ba) + fo_abs(aa - bb) > ZERO);
}
#define DEMAND_IDENTITY(name)                                                                   \
    demand(&found, is_number(c->name[0][0], c->name[0][1], c->name[1][0], c->name[1][1]),       \
           FO_ERROR_OTHER, #name);
#define DEMAND_NOTHING(name) \
    demand(&found, !(fo_abs(c->name[0]) + fo_abs(c->name[1]) > ZERO), FO_ERROR_OTHER, #name);
#endif

static finding check(const fo_config *c)
{
    finding found = {FO_OK, NULL};
    FO_CONFIG_FIELDS(DEMAND_MATRIX, DEMAND_VECTOR, DEMAND_NUMBER, DEMAND_FINITE)
    demand(&found, c->sample_time > ZERO, FO_ERROR_SAMPLE_TIME, "sample_time");
    demand(&found, memory_fits(c->memory, c->sample_time), FO_ERROR_SAMPLE_TIME, "memory");
    FO_CONFIG_FIELDS(PASSED_OVER, PASSED_OVER, PASSED_OVER, DEMAND_POSITIVE)
    FO_CONFIG_FIELDS(PASSED_OVER, PASSED_OVER, PASSED_OVER, DEMAND_RANGE)
    demand(&found, c->R[0][0] >= ZERO && c->R[1][1] >= ZERO, FO_ERROR_RANGE, "R");
    /* what these sources leave out (fluxobs_real.h) */
#if FO_ISOTROPIC
    FO_CONFIG_FIELDS(DEMAND_IDENTITY, DEMAND_NOTHING, PASSED_OVER, PASSED_OVER_RANGE)
#endif
#if !FO_HELD
    demand(&found, !(fo_abs(c->kink_now) > ZERO), FO_ERROR_OTHER, "R"); /* R h/L is large */
#endif
    return found;
}

/* Each row gives back what forgetting takes until its next turn, 1 - rho^period. */
static fo_real reinjected(fo_real rho)
{
    fo_real left = ONE;
    for (int i = 0; i < (int)REINJECT_PERIOD; i++) {
        left *= rho;
    }
    return ONE - left;
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
    const fo_real drift_base = psi / c->memory; /* time base: the memory */
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

    o->plausible = drift_prior;
    o->reinject = reinjected(o->rho);
    o->flux_base = psi;
    o->drift_base = drift_base;
    o->current_limit = c->current_limit;
    o->over_noise = ONE / ((fo_real)(20 * FO_N) * c->current_noise * c->current_noise);
    o->square_min = c->length_min * c->length_min / (psi * psi);
    o->L_position = c->L_position / psi;
    /* Current noise in x: directly through L, and through R as a random walk of the flux, which is
     * followed with about a quarter of the memory. */
    fo_real walk = ZERO;
    for (int i = 0; i < FO_N; i++) {
        walk += c->R[i][i] / (fo_real)FO_N;
    }
    walk *= walk * c->sample_time * c->memory / (fo_real)4;
    o->position_noise = (c->L_position * c->L_position + walk) * c->current_noise *
                        c->current_noise / (psi * psi);

    /* Fading-memory filter of second order, triple pole z: no lag at constant acceleration.
     * 1 / (1 + x + x^2/2) replaces exp(-x), so that the core needs no exp. */
    const fo_real x = c->tracker_bandwidth * c->sample_time;
    set_tracker(o, ONE / (ONE + x + x * x / TWO));
}

/* Do the prepared numbers leave single precision enough room? Limits are far beyond any machine. */
static finding check_prepared(const fo_observer *o)
{
    const fo_real low = (fo_real)1e-12, high = (fo_real)1e12;
    const fo_real thousand = (fo_real)1e3, million = (fo_real)1e6, most = (fo_real)1e24;
    const fo_real i = o->current_limit;
    finding found = {FO_OK, NULL};
    demand_size(&found, o->flux_base, low, high, "flux_base");
    demand_size(&found, o->drift_base, low, high, "memory");
    demand_size(&found, o->sample_time, low, high, "sample_time");
    demand_size(&found, i, low, high, "current_limit");
    for (int n = 0; n < FO_N; n++) {
        demand_size(&found, o->E[n], -thousand, thousand, "E");
        demand_size(&found, o->row_C[n] * i, -high, high, "C");
        for (int m = 0; m < FO_N; m++) {
            demand_size(&found, o->Q1x2[n][m], -thousand, thousand, "Q1");
            demand_size(&found, o->row_Q2[n][m] * i, -(fo_real)1e9, (fo_real)1e9, "Q2");
            demand_size(&found, o->row_Q3[n][m] * i * i, -high, high, "Q3");
            demand_size(&found, o->hR[n][m] * i, -thousand, thousand, "R");
            demand_size(&found, o->hB[n][m], -high, high, "B");
        }
    }
    demand_size(&found, o->plausible, (fo_real)1e-6, million, "drift_prior");
    demand_size(&found, o->row_s, (fo_real)1e-3, million, "constraint_noise");
    demand_size(&found, o->kink_now, -ONE, ONE, "kink_now");
    demand_size(&found, o->kink_before, -ONE, ONE, "kink_before");
    demand_size(&found, o->L_position * i, -million, million, "L_position");
    demand_size(&found, o->square_min, ZERO, million, "length_min");
    demand_size(&found, o->position_noise, ZERO, million, "current_noise");
    demand_size(&found, o->noise_information, ZERO, high, "current_noise");
    demand_size(&found, o->over_noise * i * i, ZERO, most, "current_noise");
    demand_size(&found, o->track[2], ZERO, most, "tracker_bandwidth");
    return found;
}

static finding prepare_checked(fo_observer *o, const fo_config *c)
{
    finding found = check(c);
    if (found.error == FO_OK) {
        prepare(o, c);
#if FO_MAPPED
        o->map = NULL;
#endif
        found = check_prepared(o);
    }
    return found;
}

fo_error fo_init(fo_observer *o, const fo_config *c) { return prepare_checked(o, c).error; }

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

/* Prior information on state i. */
static fo_real prior(const fo_state *s, int i)
{
    fo_real information = i < KAPPA ? ONE : s->drift_prior;
    if (i == KAPPA) {
        information /= (fo_real)4; /* kappa = 2 drift'Q1 flux: twice the drift's std */
    }
    if (i == CC) {
        information *= information;
    }
    return information;
}

/* Drops all information but the prior; the innovations start at their assumed level. */
static void empty_information(fo_state *s)
{
    (void)memset(&s->info, 0, sizeof s->info);
    clear(s->x);
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] = prior(s, i);
    }
    s->innovation = ZERO;
    s->power = ONE;
    s->lag_one = ZERO;
    s->noise_share = ONE;
    s->swept = ZERO;
    s->trusted = false;
    s->turn = 0U;
}

static void restart(fo_state *s)
{
    empty_information(s);
    s->have_current = false;
    s->have_voltage = false;
    s->variance = VARIANCE_UNKNOWN; /* the carried flux is lost */
}

void fo_reset(const fo_observer *o, fo_state *s)
{
    (void)memset(s, 0, sizeof *s);
    s->drift_prior = ONE / (o->plausible * o->plausible);
    s->roughness = ONE;
    restart(s);
}

/* Zero if a number is finite, else not a number. */
static inline fo_real self_difference(fo_real x) { return x - x; }

/* Weights of a state are positive, its noises finite and no larger than the inputs can make them. A
 * recursion would keep any other number, and the observer would stay invalid without a restart; the
 * rest of a state lasts a few samples. */
bool fo_damaged(const fo_observer *o, const fo_state *s)
{
    bool damaged = s->roughness == ZERO;
    if (s->turn == 1U) { /* so it is after a restart in the last step, too */
        const fo_tracker *t = &s->tracker;
        fo_real sum = self_difference(s->power) + self_difference(s->lag_one) +
                      self_difference(s->swept) + self_difference(t->angle) +
                      self_difference(t->speed) + self_difference(t->acceleration) +
                      self_difference(t->settled);
        for (int i = 0; i < FO_NX; i++) {
            sum += self_difference(s->info.d[i]);
            damaged = damaged || !(s->info.d[i] > ZERO);
        }
        for (int i = 0; i < 3; i++) {
            sum += self_difference(s->info.noise[i]);
        }
        /* A third difference of currents, and a drift that takes all of a step and was widened. */
        const fo_real swing = (fo_real)16 * o->current_limit;
        const fo_real drift = WIDEN * FLUX_STEP_LIMIT, loosest = s->drift_prior * drift * drift;
        damaged = damaged || sum != ZERO ||
                  !within(s->rough, ZERO, ONE + swing * swing * o->over_noise) ||
                  !(loosest >= o->h * o->h) ||
                  !(s->drift_prior * o->plausible * o->plausible <= TWO);
    }
    return damaged;
}

/* The immersion's step over one interval, x <- F x + b: F depends on q, b is (input, v, 0, 0, 0).
 * docs/theory.md, section 4. Per-unit. */
typedef struct {
    fo_real v[FO_N]; /* volt-seconds */
    fo_real q[FO_N]; /* 2 Q1 v */
    fo_real input;   /* v'Q1v + E'v */
} interval;

/* U <- U F^-1, d <- rho d, z <- z + U F^-1 b: F(h, v)^-1 = F(-h, -v). */
static void predict(const fo_observer *o, fo_state *s, const interval *t)
{
    const fo_real h = o->h, rho = o->rho;
    const fo_real v0 = t->v[0], v1 = t->v[1], q0 = t->q[0], q1 = t->q[1], h2 = TWO * h;
    fo_real *u = s->info.U, *z = s->info.z;
    { /* the row of s reaches every column: flux, kappa, drift, c */
        const fo_real flux0 = u[0] - q0, flux1 = u[1] - q1, kappa = u[2] - h;
        u[3] -= h * u[0] + q0 * kappa;
        u[4] -= h * u[1] + q1 * kappa;
        u[5] -= h * (u[2] + kappa);
        u[0] = flux0;
        u[1] = flux1;
        u[2] = kappa;
        z[S] += t->input + flux0 * v0 + flux1 * v1;
    }
    { /* the row of the first flux: the second, kappa, drift, c */
        const fo_real flux1 = u[6], kappa = u[7];
        u[8] -= h + q0 * kappa;
        u[9] -= h * flux1 + q1 * kappa;
        u[10] -= h2 * kappa;
        z[FLUX] += v0 + flux1 * v1;
    }
    { /* the row of the second flux: kappa, drift, c */
        const fo_real kappa = u[11];
        u[12] -= q0 * kappa;
        u[13] -= h + q1 * kappa;
        u[14] -= h2 * kappa;
        z[FLUX + 1] += v1;
    }
    u[15] -= q0; /* the row of kappa: drift, c */
    u[16] -= q1;
    u[17] -= h2;
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] *= rho;
    }
    /* The information from noise alone is carried and forgotten in the same way; it is about
     * (flux, drift), alike in both components. */
    fo_real *noise = s->info.noise;
    noise[2] = rho * (noise[2] - h * (TWO * noise[1] - h * noise[0]));
    noise[1] = rho * (noise[1] - h * noise[0]);
    noise[0] = rho * noise[0];
}

/* A measurement row'x = rhs with this weight, as the rotations so far have left it. */
typedef struct {
    fo_real rhs, weight;
} measurement;

/* The rotation of row'x = rhs with row i, after which it is zero there: Gentleman's, without
 * roots. */
static inline void rotate(fo_information *info, int i, fo_real row[FO_NX], measurement *left)
{
    fo_real *u = &info->U[AT(i, i + 1)];
    const fo_real pivot = row[i], weighted = left->weight * pivot, d = info->d[i];
    const fo_real d_new = d + weighted * pivot, inverse = ONE / d_new;
    const fo_real gain = weighted * inverse;
    left->weight *= d * inverse;
    info->d[i] = d_new;
    FO_UNROLL
    for (int j = i + 1; j < FO_NX; j++) {
        row[j] -= pivot * u[j - i - 1];
        u[j - i - 1] += gain * row[j];
    }
    left->rhs -= pivot * info->z[i];
    info->z[i] += gain * left->rhs;
}

static inline fo_real rotate_in(fo_information *info, fo_real row[FO_NX], fo_real value,
                                fo_real information, int first)
{
    measurement left = {value, information};
#if FO_WRITTEN_OUT
    if (first == (int)S) {
        FO_UNROLL
        for (int i = 0; i < FO_NX; i++) {
            rotate(info, i, row, &left);
        }
    } else
#endif
    {
        for (int i = first; i < FO_NX; i++) {
            rotate(info, i, row, &left);
        }
    }
    return fo_sqrt(left.weight) * left.rhs;
}

fo_real fo_rotate_in(fo_information *info, fo_real row[FO_NX], fo_real value, fo_real information,
                     int first)
{
    return rotate_in(info, row, value, information, first);
}

typedef struct {
    fo_real along, across;
} variances;

/* Variances of the flux along p and across it, times |p|^2: |y|^2 / d with U'y = (0, p, 0 ..). */
static variances flux_variances(const fo_information *info, const fo_real p[FO_N])
{
    const fo_real *u = &info->U[AT(FLUX, FLUX + 1)];
    variances found = {ZERO, ZERO};
    fo_real along[FO_NX], across[FO_NX];
    clear(along);
    clear(across);
    along[FLUX] = p[0];
    along[FLUX + 1] = p[1];
    across[FLUX] = -p[1];
    across[FLUX + 1] = p[0];
    FO_UNROLL
    for (int i = FLUX; i < FO_NX; i++) {
        const fo_real inverse = ONE / info->d[i], a = along[i], b = across[i];
        found.along += a * a * inverse;
        found.across += b * b * inverse;
        FO_UNROLL
        for (int j = i + 1; j < FO_NX; j++) {
            along[j] -= a * *u;
            across[j] -= b * *u;
            u++;
        }
    }
    return found;
}

/* The same for the drift, across p only. */
static fo_real drift_across(const fo_information *info, const fo_real p[FO_N])
{
    const fo_real *u = info->U, *d = info->d;
    const fo_real a = p[0] + p[1] * u[AT(DRIFT, DRIFT + 1)];
    const fo_real c = p[1] * u[AT(DRIFT, CC)] - a * u[AT(DRIFT + 1, CC)];
    return p[1] * p[1] / d[DRIFT] + a * a / d[DRIFT + 1] + c * c / d[CC];
}

/* U x = z */
static void solve(fo_state *s)
{
    const fo_real *u = &s->info.U[FO_TRIANGLE];
    FO_UNROLL
    for (int i = FO_NX - 1; i >= 0; i--) {
        fo_real sum = s->info.z[i];
        FO_UNROLL
        for (int j = FO_NX - 1; j > i; j--) {
            u--;
            sum -= *u * s->x[j];
        }
        s->x[i] = sum;
    }
}

/* ---- measurement ---------------------------------------------------------------------- */

/* Third difference of the current: removes what is smooth, and has 20 times the noise variance. */
static fo_real third_difference(const fo_state *s, int i)
{
    return s->current[0][i] - s->current[3][i] +
           (fo_real)3 * (s->current[2][i] - s->current[1][i]);
}

#if FO_MAPPED
static void turned_by(const fo_real v[FO_N], const fo_real direction[FO_N], fo_real turned[FO_N])
{
    turned[0] = direction[0] * v[0] - direction[1] * v[1];
    turned[1] = direction[1] * v[0] + direction[0] * v[1];
}

/* A cage's rotor flux follows i_d: it grows in the ratio in which the current that would keep it
 * does, d(magnetizing)/dt = (i_d - magnetizing) R_R / L_M. An offset of the currents is a ripple of
 * i_d: small differences count for little. */
static void follow_rotor(const fo_observer *o, const fo_state *s, fo_real i_d, fo_shape *f)
{
    const fo_map *map = o->map;
    const fo_shape *b = &s->before;
    f->rotor = b->rotor;
    f->square = b->square;
    const bool known = s->trusted || s->guided;
    f->magnetizing = known ? b->magnetizing : ZERO;
    if (f->magnetizing > map->still) {
        const fo_real off = i_d - f->magnetizing, square = off * off;
        const fo_real grown = map->decay * off * square / (square + map->still * map->still);
        const fo_real ratio = grown / f->magnetizing;
        f->magnetizing += grown;
        f->rotor += ratio * s->length;
        f->square += TWO * ratio * s->length * s->length;
    } else if (known) {
        f->magnetizing = i_d;
    } else {
        /* its angle is not known */
    }
}

/* The current as a rotor in this direction sees it. */
static void seen_by(const fo_real direction[FO_N], const fo_real current[FO_N], fo_real i[FO_N])
{
    const fo_real back[FO_N] = {direction[0], -direction[1]};
    turned_by(current, back, i);
}

void fo_ask_map(const fo_observer *o, fo_real angle, const fo_real current[FO_N], fo_shape *f)
{
    const fo_map *map = o->map;
    const fo_real over = ONE / o->flux_base;
    fo_real direction[FO_N], i[FO_N];
    fo_mapped at;
    fo_direction(angle, direction);
    seen_by(direction, current, i);
    fo_map_at(map, i, f->rotor * o->flux_base, &at);
    /* The relation holds for any share of the auxiliary flux; half of it needs no angle where a
     * machine is linear and has no magnets, all of it where it has no saliency. */
    const fo_real share = map->magnets ? ONE : ONE / TWO;
    const fo_real psi = map->psi * over;
    const fo_real a_d = at.auxiliary[0] * over, a_q = at.auxiliary[1] * over;
    const fo_real lean = fo_abs(a_d) > SHORTEST_ACTIVE ? a_q / a_d : ZERO;
    const fo_real beside[FO_N] = {at.flux[0] * over - a_d, at.flux[1] * over};
    const fo_real centre[FO_N] = {at.flux[0] * over - share * a_d,
                                  at.flux[1] * over - share * a_q};
    const fo_real slope[FO_N] = {ONE, lean};
    const fo_real by_current[FO_N] = {(at.by_d[0] + lean * at.by_d[1]) * over,
                                      (at.by_q[0] + lean * at.by_q[1]) * over};
    f->expected[0] = direction[0];
    f->expected[1] = direction[1];
    turned_by(beside, direction, f->away);
    turned_by(centre, direction, f->centre);
    turned_by(slope, direction, f->slope);
    turned_by(by_current, direction, f->by_current);
    f->active = map->kind == FO_MAP_CAGE ? a_d : fo_abs(a_d);
    f->outside = at.outside;
    if (map->kind != FO_MAP_CAGE) {
        f->square = share * share * (a_d * a_d + a_q * a_q) - psi * psi;
    }
}

/* Asks the map about the newest current, at the angle where the tracker expects the rotor. */
static void shape(const fo_observer *o, fo_state *s)
{
    fo_shape *f = &s->shape;
    const fo_real *current = s->current[0];
    if (mapped(o)) {
        const fo_real angle = s->guided ? s->guide : expected_angle(o, &s->tracker);
        if (o->map->kind == FO_MAP_CAGE) {
            fo_real direction[FO_N], i[FO_N];
            fo_direction(angle, direction);
            seen_by(direction, current, i);
            follow_rotor(o, s, i[0], f);
        }
        fo_ask_map(o, angle, current, f);
    } else {
        for (int i = 0; i < FO_N; i++) {
            f->away[i] = o->L_position * current[i];
        }
    }
}
#endif

/* The measurement 0 = s + (Q2 i)'flux + i'Q3 i + C'i, divided by its noise: row'x = the value
 * returned. With a map, 0 = s - 2 centre'flux + |centre|^2 - square. */
static fo_real relation(const fo_observer *o, const fo_state *s, fo_real row[FO_NX])
{
    const fo_real *current = s->current[0];
    fo_real rhs = ZERO;
    clear(row);
    row[S] = o->row_s;
#if FO_MAPPED
    if (mapped(o)) {
        const fo_shape *f = &s->shape;
        for (int i = 0; i < FO_N; i++) {
            row[FLUX + i] = -TWO * o->row_s * f->centre[i];
        }
        rhs = o->row_s * (f->square - dot(f->centre, f->centre));
    } else
#endif
    {
        for (int i = 0; i < FO_N; i++) {
            row[FLUX + i] = row_of(o->row_Q2, i, current);
            rhs -= current[i] * plus_linear(row_of(o->row_Q3, i, current), o->row_C[i]);
        }
    }
    return rhs;
}

/* Is the measurement far from what the estimate before the interval predicts? */
static bool contradicts(const fo_observer *o, const fo_state *s, const interval *t,
                        const fo_real row[FO_NX], fo_real rhs)
{
    const fo_real h = o->h, *x = s->x;
    fo_real off = rhs;
    fo_real free = x[S] + t->input + h * (x[KAPPA] + h * x[CC]);
    for (int i = 0; i < FO_N; i++) {
        const fo_real flux = x[FLUX + i] + h * x[DRIFT + i];
        free += t->q[i] * flux;
        off -= row[FLUX + i] * (flux + t->v[i]);
    }
    off -= row[S] * free;
    return !(fo_abs(off) < OUTLIER_LIMIT * row[S]);
}

/* Takes in row'x = rhs; follows the power of the innovations, and the noise of the current. */
static void measure(const fo_observer *o, fo_state *s, fo_real row[FO_NX], fo_real rhs)
{
    const fo_real e = rotate_in(&s->info, row, rhs, ONE, S);
    const fo_real third0 = third_difference(s, 0), third1 = third_difference(s, 1);
    const fo_real share = o->h * e;
    s->power = o->rho * s->power + share * e;
    s->lag_one = o->rho * s->lag_one + share * s->innovation;
    s->innovation = e;
    s->info.noise[0] += o->noise_information * s->roughness;
    s->rough += o->h * ((third0 * third0 + third1 * third1) * o->over_noise - s->rough);
    s->roughness = s->rough > ONE ? s->rough : ONE;
}

/* ---- read-out ------------------------------------------------------------------------- */

/* Position vector x = flux - L i; returns |x|^2. */
static fo_real position(const fo_observer *o, const fo_state *s, const fo_real flux[FO_N],
                        fo_real p[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        p[i] = flux[i] - away(o, s, i);
    }
    return dot(p, p);
}

/* Gives all that is known less weight. */
static void discount(fo_state *s, fo_real keep)
{
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] *= keep;
    }
    for (int i = 0; i < 3; i++) {
        s->info.noise[i] *= keep;
    }
}

/* A wrong prior is forgotten slowly: widens it, and gives its effect so far little weight. */
static void widen_prior(fo_state *s, fo_real excess)
{
    s->drift_prior /= WIDEN * excess;
    discount(s, DISTRUST / excess);
}

/* Judges the position vector p by the information: the variance of its angle, and the share of the
 * flux information that is only noise. */
static void judge(fo_state *s, const fo_real p[FO_N], fo_real square)
{
    /* A prior that is too tight makes the covariance too small by the same factor. */
    const fo_real *drift = &s->x[DRIFT];
    const fo_real excess = dot(drift, drift) * s->drift_prior;
    const variances flux = flux_variances(&s->info, p);
    const fo_real across = flux.across / square, along = flux.along / square;
    /* Information on the flux from noise alone, if the drift is unknown. */
    const fo_real *noise = s->info.noise;
    const fo_real shared = noise[2] > ZERO ? noise[1] * noise[1] / noise[2] : ZERO;
    s->noise_share = (noise[0] - shared) * (across + along);
    /* The variance scales with the innovations' colour, and with their power over the assumed. */
    const fo_real r = correlation(s->lag_one, s->power);
    s->inflation = s->power * (ONE + r) / (ONE - r);
    s->spread = s->inflation * across / square;
    if (excess > ONE) {
        s->spread *= excess;
        if (s->trusted && fo_abs(s->swept) > SETTLED) {
            widen_prior(s, excess);
        }
    }
}

/* Re-injects one prior row, centred on the estimate: it bounds the standard deviations and moves
 * nothing. */
static void reinject_prior(const fo_observer *o, fo_state *s, int i)
{
    fo_real row[FO_NX];
    clear(row);
    row[i] = ONE;
    (void)rotate_in(&s->info, row, s->x[i], o->reinject * prior(s, i), i);
}

/* Carries the last trusted flux on by integration; returns the variance of its angle. The variance
 * grows with the uncertainty of the drift and with a voltage error as large as the drift's prior. A
 * change in the length of the position vector, which should be constant, shows a larger error and
 * adds to it. Once the angle is unknown, the flux stays where it is. */
static fo_real carry_on(const fo_observer *o, fo_state *s, const fo_real v[FO_N])
{
    fo_real p[FO_N], flux[FO_N];
    if (s->carried == ZERO) {
        const fo_real square = position(o, s, s->flux, p);
        const fo_real across = drift_across(&s->info, p) / square;
        s->growth = (s->inflation * across + o->plausible * o->plausible) / square;
        s->carried_length = fo_sqrt(square);
#if FO_MAPPED
        s->carried_length -= mapped(o) ? s->shape.active : ZERO;
#endif
        s->carried_off = ZERO;
    }
    s->carried += o->h;
    for (int i = 0; i < FO_N; i++) {
        flux[i] = s->flux[i] + v[i] + o->h * s->drift[i];
    }
    fo_real usual = s->carried_length;
#if FO_MAPPED
    if (mapped(o)) { /* the map says what it should be */
        usual += s->shape.active;
        usual = usual > SHORTEST_ACTIVE ? usual : SHORTEST_ACTIVE;
    }
#endif
    const fo_real off = fo_sqrt(position(o, s, flux, p)) / usual - ONE;
    s->carried_off = off * off > s->carried_off ? off * off : s->carried_off;
    const fo_real variance = s->variance + s->growth * s->carried * s->carried + s->carried_off;
    if (variance < VARIANCE_UNKNOWN) {
        s->flux[0] = flux[0];
        s->flux[1] = flux[1];
    }
    return variance;
}

/* Decides which flux is reported: that of the least squares while it is trusted or nothing better
 * is known, else the last trusted one, carried on. See docs/theory.md, section 6. */
static void read_out(const fo_observer *o, fo_state *s, const fo_real v[FO_N], fo_estimate *e)
{
    fo_real p[FO_N];
    solve(s);
    const fo_real *flux = &s->x[FLUX], *drift = &s->x[DRIFT];
    fo_real square = position(o, s, flux, p);
    if (!(square < RUNAWAY)) { /* or not a number; happens after a long rest */
        s->restarts++;
        empty_information(s);
        square = position(o, s, flux, p);
    }
    fo_real theta = fo_atan2(p[1], p[0]);

    const bool long_enough = square > o->square_min;

    if ((s->turn & 1U) == 0U) {
        reinject_prior(o, s, (int)s->turn / 2);
    } else if (long_enough) {
        judge(s, p, square);
    } else {
        s->noise_share = ONE;
    }
    s->turn = s->turn + 1U < (uint32_t)REINJECT_PERIOD ? s->turn + 1U : 0U;

    const bool known = long_enough && s->noise_share < SHARE_LIMIT;
    s->swept = known ? s->swept + wrap(theta - s->theta) : ZERO;
    s->theta = theta;
    const bool trusted = known && (s->trusted || fo_abs(s->swept) > SWEEP);

    /* The turn of the flux by a voltage error adds up until the rotor has turned by about a radian.
     * It is bounded, so that it is forgotten soon after a stop. */
    const fo_real turned = fo_abs(s->tracker.speed) * o->sample_time;
    s->exposed += o->h * o->plausible - s->exposed * (turned < ONE ? turned : ONE);
    s->exposed = s->exposed < EXPOSED_MOST ? s->exposed : EXPOSED_MOST;

    fo_real variance = VARIANCE_UNKNOWN;
    if (trusted) {
        /* The covariance across p, and the current noise in p. */
        variance = s->spread + o->position_noise * s->roughness / square +
                   rippled(o, s->tracker.speed);
        s->variance = variance;
        s->carried = ZERO;
        s->have_carried = true;
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] = flux[i];
            s->drift[i] = drift[i];
        }
    } else if (s->have_carried) {
        variance = carry_on(o, s, v);
        if (!known || variance < VARIANCE_UNKNOWN) {
            flux = s->flux;
            drift = s->drift;
            square = position(o, s, flux, p);
            theta = fo_atan2(p[1], p[0]);
        }
    } else {
        /* nothing better is known */
    }
    const bool lost = !(variance >= ZERO && variance < VARIANCE_UNKNOWN);
    if (lost) {
        variance = VARIANCE_UNKNOWN;
    }
    if (lost && !known) {
        stop_tracker(&s->tracker, theta);
    } else {
        track(o, &s->tracker, theta);
    }
    s->length = fo_sqrt(square);
#if FO_MAPPED
    if (mapped(o)) {
        if (trusted && !s->trusted) {
            discount(s, DISTRUST); /* its rows asked the map at wrong angles */
        }
        s->before = s->shape;
        s->outside += trusted && s->shape.outside ? 1U : 0U;
    }
#endif
    s->trusted = trusted;
    e->theta_e_std = fo_sqrt(variance);
    if (trusted) {
        settle_tracker(o, &s->tracker, theta, e->theta_e_std);
    } else {
        s->tracker.settled = ZERO;
    }

    for (int i = 0; i < FO_N; i++) {
        e->flux[i] = flux[i] * o->flux_base;
        e->drift[i] = drift[i] * o->drift_base;
    }
    e->psi_f = s->length * o->flux_base;
    e->theta_e = theta;
    e->theta_e_tracked = s->tracker.angle;
    e->speed_e = s->tracker.speed;
    e->innovation = s->innovation;
    e->noise_share = s->noise_share;
    /* A slow turn by a voltage error of plausible size leaves no trace in the innovations. */
    e->valid = trusted && s->tracker.settled >= TRACKER_SETTLED &&
               variance < STD_LIMIT * STD_LIMIT && s->exposed < VOLTAGE_LIMIT * s->length;
#if FO_MAPPED
    if (mapped(o)) { /* the map was asked where the tracker expected the rotor */
        const bool near = fo_abs(wrap(theta - s->tracker.angle)) < STD_LIMIT;
        e->valid = e->valid && near && !s->shape.outside;
    }
#endif
}

/* ---- samples -------------------------------------------------------------------------- */

/* Subtracts the resistive drop, unless the source's volt-seconds are `complete`. */
static void last_interval(const fo_observer *o, const fo_state *s, bool complete, interval *t)
{
    fo_real mean[FO_N] = {0};
    for (int i = 0; i < FO_N && !complete; i++) {
        mean[i] = mean_current_24(s->current[0][i], s->current[1][i], s->current[2][i],
                                  s->current[3][i]);
    }
    for (int i = 0; i < FO_N; i++) {
        t->v[i] = s->source[i] - row_of(o->hR, i, mean);
    }
    for (int i = 0; i < FO_N; i++) {
        t->q[i] = row_of(o->Q1x2, i, t->v);
    }
    t->input = plus_linear(dot(t->q, t->v) / TWO, dot(o->E, t->v));
}

/* Step of the position vector over the interval; the drift is negligible. */
static fo_real position_step(const fo_observer *o, const fo_state *s, const fo_real v[FO_N])
{
    fo_real step[FO_N];
    for (int i = 0; i < FO_N; i++) {
        step[i] = v[i] - o->L_position * (s->current[0][i] - s->current[1][i]);
#if FO_MAPPED
        if (mapped(o)) {
            step[i] = v[i] - (s->shape.away[i] - s->before.away[i]);
        }
#endif
    }
    return fo_sqrt(dot(step, step));
}

static bool leaps(const fo_observer *o, const fo_state *s, fo_real step)
{
    return step > TWO * s->step + STEP_LIMIT * s->length +
                      STEP_NOISE * fo_sqrt(o->position_noise * s->roughness);
}

/* The newest current in the relation; it has changed. */
static fo_real taken_in(const fo_observer *o, fo_state *s, fo_real row[FO_NX])
{
#if FO_MAPPED
    shape(o, s);
#endif
    return relation(o, s, row);
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

/* Predicts a missing vector: it goes on turning with the rotor, if that is known, by the angle
 * whose half has the tangent speed * sample_time / 2. */
static void ahead(const fo_observer *o, const fo_state *s, const fo_real before[FO_N],
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

static sample_quality quality(const fo_real x[FO_N], fo_real limit)
{
    sample_quality found = GOOD;
    if (!(dot(x, x) <= limit * limit)) { /* x - x is not 0 where x is not finite */
        found = (x[0] - x[0]) + (x[1] - x[1]) == ZERO ? ABSURD : MISSING;
    }
    return found;
}

/* One sample; `source` in per-unit volt-seconds, complete or still to lose the resistive drop. */
static void advance(const fo_observer *o, fo_state *s, const fo_real source[FO_N], bool complete,
                    const fo_real current[FO_N], fo_estimate *e)
{
    interval t = {{ZERO, ZERO}, {ZERO, ZERO}, ZERO};
    if (fo_damaged(o, s)) {
        const uint32_t restarts = s->restarts;
        fo_reset(o, s);
        s->restarts = restarts + 1U;
    }
    const sample_quality of_source = quality(source, FLUX_STEP_LIMIT);
    const sample_quality of_current = quality(current, o->current_limit);
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
            ahead(o, s, s->current[0], newest);
        }
        for (int times = s->have_current ? 1 : (int)FO_HISTORY; times > 0; times--) {
            push_current(s, newest[0], newest[1]);
        }
        if (of_source == GOOD && s->have_current) {
            s->have_voltage = true;
            s->source[0] = source[0];
            s->source[1] = source[1];
        } else {
            ahead(o, s, s->source, s->source);
        }
        s->have_current = true;
        const fo_real rhs = taken_in(o, s, row);
        if (s->have_voltage) {
            last_interval(o, s, complete, &t);
            const fo_real step = position_step(o, s, t.v);
            if (measured && s->trusted &&
                (leaps(o, s, step) || contradicts(o, s, &t, row, rhs))) {
                s->outliers++; /* treat it as missing */
                measured = false;
                bad = true;
                ahead(o, s, s->current[1], s->current[0]);
                (void)taken_in(o, s, row);
                last_interval(o, s, complete, &t);
            } else {
                s->step = step;
            }
            predict(o, s, &t);
        } else {
            empty_information(s); /* the past cannot be connected to this sample */
        }
        if (measured) {
            measure(o, s, row, rhs);
        }
    }
    s->consecutive_bad = bad ? s->consecutive_bad + 1U : 0U;
    if (absurd || (s->have_current && s->consecutive_bad > (uint32_t)FO_MAX_CONSECUTIVE_BAD)) {
        s->restarts++;
        restart(s);
    }
    read_out(o, s, t.v, e);
    e->valid = e->valid && !bad;
}

#if FO_HELD
/* Volt-seconds of a voltage that is held over the sample: less what the kinks that its steps put
 * into the current add to the resistive drop. A cubic through the samples does not see them. */
static void less_kinks(const fo_observer *o, fo_state *s, fo_real source[FO_N])
{
    const bool good = quality(source, FLUX_STEP_LIMIT) == GOOD;
    for (int i = 0; i < FO_N && good; i++) {
        const fo_real given = source[i], before = s->have_voltage ? s->kink[i] : ZERO;
        s->kink[i] = s->have_voltage ? given - s->given[i] : ZERO;
        s->given[i] = given;
        source[i] = given - o->kink_now * s->kink[i] - o->kink_before * before;
    }
}
#endif

void fo_step(const fo_observer *o, fo_state *s, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *e)
{
    fo_real source[FO_N];
    for (int i = 0; i < FO_N; i++) {
        source[i] = row_of(o->hB, i, voltage);
    }
#if FO_HELD
    if (o->kink_now != ZERO) {
        less_kinks(o, s, source);
    }
#endif
    advance(o, s, source, false, current, e);
}

void fo_step_volt_seconds(const fo_observer *o, fo_state *s, const fo_real volt_seconds[FO_N],
                          const fo_real current[FO_N], fo_estimate *e)
{
    fo_real source[FO_N];
    for (int i = 0; i < FO_N; i++) {
        source[i] = volt_seconds[i] / o->flux_base;
    }
    advance(o, s, source, true, current, e);
}

void fo_gather(const fo_observer *o, fo_gathered *g, fo_real share, const fo_real voltage[FO_N],
               const fo_real current[FO_N])
{
    const fo_real scale = share * o->flux_base;
    fo_real mean[FO_N]; /* 24 times the mean current, by the trapezoid rule: intervals are short */
    for (int i = 0; i < FO_N; i++) {
        mean[i] = (fo_real)12 * (g->current[i] + current[i]);
        g->current[i] = current[i];
    }
    for (int i = 0; i < FO_N; i++) {
        g->volt_seconds[i] += scale * (row_of(o->hB, i, voltage) - row_of(o->hR, i, mean));
    }
}

/* The observer for an interval of this duration [s], which must be plausible. */
static void stretch(const fo_observer *o, fo_real duration, fo_observer *stretched)
{
    const fo_real ratio = duration / o->sample_time;
    /* The tracker's pole p, from its gains: 1.5 h track[2] / track[1] = (1 - p) / (1 + p). Its
     * bandwidth stays: 1/p - 1 is proportional to the duration, to first order. */
    const fo_real q = (fo_real)1.5 * o->sample_time * o->track[2] / o->track[1];
    const fo_real over = TWO * q / (ONE - q); /* 1/p - 1 */
    *stretched = *o;
    stretched->sample_time = duration;
    stretched->h = o->h * ratio;
    stretched->rho = ONE - stretched->h;
    stretched->reinject = reinjected(stretched->rho);
    for (int i = 0; i < FO_N; i++) {
        for (int j = 0; j < FO_N; j++) {
            stretched->hR[i][j] = o->hR[i][j] * ratio;
            stretched->hB[i][j] = o->hB[i][j] * ratio;
        }
    }
    set_tracker(stretched, ONE / (ONE + over * ratio));
}

void fo_uneven(const fo_observer *o, const fo_state *s, fo_real duration,
               const fo_real voltage[FO_N], const fo_real current[FO_N], fo_observer *now,
               fo_gathered *g)
{
    const bool usual =
        within(duration, o->sample_time / (fo_real)10, o->sample_time * (fo_real)10);
    stretch(o, usual ? duration : o->sample_time, now);
    for (int i = 0; i < FO_N; i++) {
        g->volt_seconds[i] = ZERO;
        g->current[i] = s->current[0][i];
    }
    fo_gather(now, g, ONE, voltage, current);
    if (!usual) {
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
