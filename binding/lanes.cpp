/* Processes the regular samples of fluxobs.c in lanes. The algebra is that of the firmware,
 * compiled for vectors (fluxobs_algebra.h). Branches of fluxobs.c that skip work are selections
 * here; the arithmetic has the same order, so that rounding is the same. If a lane's sample is bad
 * or an outlier, fo_step processes it. tests/observers/test_lanes.py compares every output and
 * every byte of the states. */
#include "lanes.h"

extern "C" {
#include "columns.h"
#include "fluxobs_internal.h"
}

#if !defined(__GNUC__)

bool lanes_here() { return false; }
void lanes_run(const fo_observer *, fo_state *, const double *, const double *, size_t, double *,
               size_t, bool *) {}

#else

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace {

#if FO_SINGLE
typedef int32_t integer;
#else
typedef int64_t integer;
#endif
typedef fo_real V __attribute__((vector_size(32)));
typedef integer M __attribute__((vector_size(32))); /* mask: all bits of a lane, or none */

inline V select(M mask, V yes, V no) {
#if defined(__AVX2__) && FO_SINGLE
    return reinterpret_cast<V>(_mm256_blendv_ps(reinterpret_cast<__m256>(no),
                                                reinterpret_cast<__m256>(yes),
                                                reinterpret_cast<__m256>(mask)));
#elif defined(__AVX2__)
    return reinterpret_cast<V>(_mm256_blendv_pd(reinterpret_cast<__m256d>(no),
                                                reinterpret_cast<__m256d>(yes),
                                                reinterpret_cast<__m256d>(mask)));
#else
    return reinterpret_cast<V>((mask & reinterpret_cast<M>(yes)) |
                               (~mask & reinterpret_cast<M>(no)));
#endif
}
inline V all(fo_real x) { return V{} + x; }
inline V size(V x) { /* clears the sign bit, as fabs does */
    const M sign = (M{} + 1) << (8 * static_cast<int>(sizeof(integer)) - 1);
    return reinterpret_cast<V>(reinterpret_cast<M>(x) & ~sign);
}
inline bool any(M mask) {
#if defined(__AVX2__)
    return !_mm256_testz_si256(reinterpret_cast<__m256i>(mask), reinterpret_cast<__m256i>(mask));
#else
    integer bits = 0;
    for (int k = 0; k < LANES; k++) bits |= mask[k];
    return bits != 0;
#endif
}
inline V root(V x) {
#if defined(__AVX2__) && FO_SINGLE
    return reinterpret_cast<V>(_mm256_sqrt_ps(reinterpret_cast<__m256>(x)));
#elif defined(__AVX2__)
    return reinterpret_cast<V>(_mm256_sqrt_pd(reinterpret_cast<__m256d>(x)));
#else
    V out = x;
    for (int k = 0; k < LANES; k++) out[k] = fo_sqrt(x[k]);
    return out;
#endif
}

inline V inner(const V a[2], const V b[2]) { return a[0] * b[0] + a[1] * b[1]; }
inline V inner(const fo_real a[2], const V b[2]) { return a[0] * b[0] + a[1] * b[1]; }

inline V wrapped(V angle) {
    const V low = select(angle <= -PI, angle + TWO * PI, angle);
    return select(angle > PI, angle - TWO * PI, low);
}

constexpr fo_real FO_ATAN[] = FO_ATAN_SERIES;

/* fo_atan2 */
inline V atan2_of(V y, V x) {
    const V up = size(y), along = size(x);
    const M steep = up > along;
    const V less = select(steep, along, up), more = select(steep, up, along);
    V q = select(more > ZERO, less / more, more);
    const M between = q > FO_NEAR_BETWEEN, near = q > FO_NEAR_ZERO;
    const V second = (less - more) / (more + less);
    const V first = (less - FO_TAN_BETWEEN * more) / (more + FO_TAN_BETWEEN * less);
    q = select(between, second, select(near, first, q));
    const V from = select(between, all(PI / (fo_real)4), select(near, all(FO_BETWEEN), V{}));
    const V square = q * q;
    V series = all(FO_ATAN[0]);
    for (size_t k = 1; k < sizeof FO_ATAN / sizeof FO_ATAN[0]; k++)
        series = FO_ATAN[k] + square * series;
    V angle = from + (q + q * (square * series));
    angle = select(steep, PI / TWO - angle, angle);
    angle = select(x < ZERO, PI - angle, angle);
    return select(y < ZERO, -angle, angle);
}

/* Numbers of fo_state that a good sample changes. */
#define LANE_NUMBERS(X)                                                                        \
    X(step) X(length) X(noise_ratio) X(noise_ratio_without_ripple) X(noise_inflation)          \
    X(voltage_turn) X(innovation) X(power) X(lag_one) X(noise_share) X(inflation)              \
    X(angle_variance) X(drift_prior) X(theta)                                                  \
    X(rotation) X(variance) X(variance_growth) X(open_loop_time) X(open_loop_length)           \
    X(open_loop_error) X(tracker.angle) X(tracker.speed) X(tracker.acceleration)               \
    X(tracker.settled)
#define LANE_ARRAYS(X)                                                                         \
    X(info.U, FO_TRIANGLE) X(info.d, FO_NX) X(info.z, FO_NX) X(info.noise, 3) X(x, FO_NX)      \
    X(current[0], FO_N) X(current[1], FO_N) X(current[2], FO_N) X(current[3], FO_N)            \
    X(source, FO_N) X(volt_seconds, FO_N) X(held_source, FO_N) X(source_step, FO_N)             \
    X(flux, FO_N) X(drift, FO_N)

struct Factor {
    V U[FO_TRIANGLE], d[FO_NX], z[FO_NX], noise[3];
};

struct Lanes {
    Factor info;
    V x[FO_NX], current[FO_HISTORY][FO_N], source[FO_N], held_source[FO_N], source_step[FO_N];
    V volt_seconds[FO_N], flux[FO_N], drift[FO_N];
    V step, length, noise_ratio, noise_ratio_without_ripple, noise_inflation, voltage_turn,
        innovation, power, lag_one,
        noise_share, inflation, angle_variance, drift_prior, theta, rotation, variance,
        variance_growth, open_loop_time, open_loop_length, open_loop_error;
    struct {
        V angle, speed, acceleration, settled;
    } tracker;
    M trusted, have_trusted_flux, lost, round_index, restarts, consecutive_bad;
};

void load(Lanes &l, int k, const fo_state &s) {
#define LOAD_NUMBER(name) l.name[k] = s.name;
#define LOAD_ARRAY(name, count) \
    for (int n = 0; n < (count); n++) l.name[n][k] = s.name[n];
    LANE_NUMBERS(LOAD_NUMBER)
    LANE_ARRAYS(LOAD_ARRAY)
    l.trusted[k] = -static_cast<integer>(s.trusted);
    l.have_trusted_flux[k] = -static_cast<integer>(s.have_trusted_flux);
    l.lost[k] = -static_cast<integer>(s.tracker.lost);
    l.round_index[k] = static_cast<integer>(s.round_index);
    l.restarts[k] = 0;
    l.consecutive_bad[k] = static_cast<integer>(s.consecutive_bad);
}

void store(const fo_observer &o, const Lanes &l, int k, fo_state &s) {
#define STORE_NUMBER(name) s.name = l.name[k];
#define STORE_ARRAY(name, count) \
    for (int n = 0; n < (count); n++) s.name[n] = l.name[n][k];
    LANE_NUMBERS(STORE_NUMBER)
    LANE_ARRAYS(STORE_ARRAY)
    s.trusted = l.trusted[k] != 0;
    s.have_trusted_flux = l.have_trusted_flux[k] != 0;
    s.tracker.lost = l.lost[k] != 0;
    s.round_index = static_cast<uint32_t>(l.round_index[k]);
    s.restarts += static_cast<uint32_t>(l.restarts[k]);
    s.consecutive_bad = static_cast<uint32_t>(l.consecutive_bad[k]);
#if FO_MAPPED
    for (int n = 0; n < FO_N; n++) s.map_point.armature_flux[n] = o.L_position * s.current[0][n];
#else
    (void)o;
#endif
}

/* Can a state be processed in a lane? */
bool is_regular(const fo_state &s) { return !is_never_reset(&s) && s.have_current && s.have_voltage; }

#define FO_VALUE V
#define FO_ZERO V{}
#define FO_FACTOR Factor
#include "fluxobs_algebra.h"

/* Adds a row whose elements before `First` are zero. */
template <int First> inline void add_row(Factor &info, V row[FO_NX], measurement &m) {
#pragma GCC unroll 8
    for (int i = First; i < FO_NX; i++) rotate_row(&info, i, row, &m);
}

/* Prior information on state i. */
inline V prior_information(const Lanes &l, int i) {
    V prior = i < KAPPA ? all(ONE) : l.drift_prior;
    if (i == KAPPA) prior /= (fo_real)4;
    if (i == CC) prior *= prior;
    return prior;
}

/* Re-injects row I of the prior. */
template <int I> void reinject_all(const fo_observer &o, Lanes &l) {
    V row[FO_NX] = {};
    row[I] = all(ONE);
    measurement m = {l.x[I], o.reinject * prior_information(l, I)};
    add_row<I>(l.info, row, m);
}

template <int I> void reinject(const fo_observer &o, Lanes &l, M due) {
    if (any(due)) {
        const auto before = l.info;
        reinject_all<I>(o, l);
        for (int n = 0; n < FO_TRIANGLE; n++) l.info.U[n] = select(due, l.info.U[n], before.U[n]);
        for (int n = 0; n < FO_NX; n++) {
            l.info.d[n] = select(due, l.info.d[n], before.d[n]);
            l.info.z[n] = select(due, l.info.z[n], before.z[n]);
        }
    }
}

/* The lanes are usually at the same place in the round. */
inline void reinject_due(const fo_observer &o, Lanes &l, M turn) {
    switch (any(turn != turn[0]) ? -1 : turn[0]) {
        case 0: reinject_all<0>(o, l); break;
        case 2: reinject_all<1>(o, l); break;
        case 4: reinject_all<2>(o, l); break;
        case 6: reinject_all<3>(o, l); break;
        case 8: reinject_all<4>(o, l); break;
        case 10: reinject_all<5>(o, l); break;
        case 12: reinject_all<6>(o, l); break;
        default:
            reinject<0>(o, l, turn == 0);
            reinject<1>(o, l, turn == 2);
            reinject<2>(o, l, turn == 4);
            reinject<3>(o, l, turn == 6);
            reinject<4>(o, l, turn == 8);
            reinject<5>(o, l, turn == 10);
            reinject<6>(o, l, turn == 12);
    }
}

inline V position_vector(const fo_observer &o, const Lanes &l, const V flux[2], V p[2]) {
    for (int i = 0; i < FO_N; i++) p[i] = flux[i] - o.L_position * l.current[0][i];
    return inner(p, p);
}

/* Does the work of update_variances (fluxobs.c) in the lanes `due`, if the position vector is long
 * enough. */
inline void update_variances(Lanes &l, const V p[2], V square, M due, M long_enough) {
    const M which = due & long_enough;
    const V *drift = &l.x[DRIFT], *noise = l.info.noise;
    const V excess = inner(drift, drift) * l.drift_prior;
    const variances sum = flux_variances(&l.info, p);
    const V over_across = sum.across / square, over_along = sum.along / square;
    const V shared = select(noise[2] > ZERO, noise[1] * noise[1] / noise[2], V{});
    const V share = (noise[0] - shared) * (over_across + over_along);
    V r = select(l.power > ZERO, l.lag_one / l.power, V{});
    r = select(r > ZERO, select(r > CORRELATION_LIMIT, all(CORRELATION_LIMIT), r), V{});
    const V inflation = l.power * (ONE + r) / (ONE - r);
    V spread = inflation * over_across / square;
    const M tight = excess > ONE;
    spread = select(tight, spread * excess, spread);
    l.noise_share = select(due, select(long_enough, share, all(ONE)), l.noise_share);
    l.inflation = select(which, inflation, l.inflation);
    l.angle_variance = select(which, spread, l.angle_variance);
    const M widened = which & tight & l.trusted & (size(l.rotation) > SETTLED);
    if (any(widened)) {
        const V keep = select(widened, DISTRUST / excess, all(ONE));
        l.drift_prior = select(widened, l.drift_prior / (WIDEN * excess), l.drift_prior);
        for (int n = 0; n < FO_NX; n++) l.info.d[n] *= keep;
        for (int n = 0; n < 3; n++) l.info.noise[n] *= keep;
    }
}

/* Does the work of integrate_open_loop (fluxobs.c) in the lanes `which`. */
inline V integrate_open_loop(const fo_observer &o, Lanes &l, const V v[2], M which) {
    V p[2], flux[2];
    const M first = which & (l.open_loop_time == ZERO);
    if (any(first)) {
        const V square = position_vector(o, l, l.flux, p);
        const V known = drift_variance_across(&l.info, p);
        const V growth =
            (l.inflation * (known / square) + o.drift_prior_std * o.drift_prior_std) / square;
        l.variance_growth = select(first, growth, l.variance_growth);
        l.open_loop_length = select(first, root(square), l.open_loop_length);
        l.open_loop_error = select(first, V{}, l.open_loop_error);
    }
    l.open_loop_time = select(which, l.open_loop_time + o.h, l.open_loop_time);
    for (int i = 0; i < FO_N; i++) flux[i] = l.flux[i] + v[i] + o.h * l.drift[i];
    const V off = root(position_vector(o, l, flux, p)) / l.open_loop_length - ONE;
    const V worse = select(off * off > l.open_loop_error, off * off, l.open_loop_error);
    l.open_loop_error = select(which, worse, l.open_loop_error);
    const V variance =
        l.variance + l.variance_growth * l.open_loop_time * l.open_loop_time + l.open_loop_error;
    const M on = which & (variance < VARIANCE_UNKNOWN);
    for (int i = 0; i < FO_N; i++) l.flux[i] = select(on, flux[i], l.flux[i]);
    return variance;
}

/* Estimates of a step, in lanes. */
struct Estimates {
    V flux[2], psi_f, theta_e, theta_e_tracked, speed_e, drift[2], theta_e_std, innovation,
        noise_share;
    M valid;
};

/* A sample and its measurement row, before the state changes. */
struct Sample {
    V held_source[2], source_step[2]; /* volt-seconds of a held voltage, and their step */
    V source[2], current[2];          /* volt-seconds without kinks */
    V row[FO_NX], rhs;
    interval t;
    V length;                         /* length of the position vector's step */
    M irregular;                      /* a bad sample or an outlier, for the scalar step */
};

inline void prepare_sample(const fo_observer &o, const Lanes &l, const V voltage[2], const V current[2],
                    Sample &s) {
    V mean[2], moved[2];
    for (int i = 0; i < FO_N; i++) s.source[i] = inner(o.hB[i], voltage);
    M good = inner(s.source, s.source) <= FLUX_STEP_LIMIT * FLUX_STEP_LIMIT;
    for (int i = 0; i < FO_N; i++) {
        s.current[i] = current[i];
        s.held_source[i] = l.held_source[i];
        s.source_step[i] = l.source_step[i];
    }
    if (o.kink_now != ZERO) {
        for (int i = 0; i < FO_N; i++) {
            s.source_step[i] = s.source[i] - l.held_source[i];
            s.held_source[i] = s.source[i];
            s.source[i] =
                s.source[i] - o.kink_now * s.source_step[i] - o.kink_before * l.source_step[i];
        }
        good &= inner(s.source, s.source) <= FLUX_STEP_LIMIT * FLUX_STEP_LIMIT;
    }
    good &= inner(current, current) <= o.current_limit * o.current_limit;

    s.rhs = V{};
    for (int n = 0; n < FO_NX; n++) s.row[n] = V{};
    s.row[S] = all(o.row_s);
    for (int i = 0; i < FO_N; i++) {
        s.row[FLUX + i] = inner(o.row_Q2[i], current);
        s.rhs -= current[i] * (inner(o.row_Q3[i], current) + o.row_C[i]);
    }
    for (int i = 0; i < FO_N; i++)
        mean[i] = (fo_real)9 * current[i] + (fo_real)19 * l.current[0][i] -
                  (fo_real)5 * l.current[1][i] + l.current[2][i];
    for (int i = 0; i < FO_N; i++) s.t.v[i] = s.source[i] - inner(o.hR[i], mean);
    for (int i = 0; i < FO_N; i++) s.t.q[i] = inner(o.Q1x2[i], s.t.v);
    s.t.input = inner(s.t.q, s.t.v) / TWO + inner(o.E, s.t.v);

    for (int i = 0; i < FO_N; i++)
        moved[i] = s.t.v[i] - o.L_position * (current[i] - l.current[0][i]);
    s.length = root(inner(moved, moved));
    const V usual = TWO * l.step + STEP_LIMIT * l.length +
                    STEP_NOISE * root(o.position_noise * l.noise_inflation);
    V off = s.rhs, free = l.x[S] + s.t.input + o.h * (l.x[KAPPA] + o.h * l.x[CC]);
    for (int i = 0; i < FO_N; i++) {
        const V flux = l.x[FLUX + i] + o.h * l.x[DRIFT + i];
        free += s.t.q[i] * flux;
        off -= s.row[FLUX + i] * (flux + s.t.v[i]);
    }
    off -= s.row[S] * free;
    const M outlier = l.trusted & ((s.length > usual) | ~(size(off) < OUTLIER_LIMIT * s.row[S]));
    s.irregular = ~good | outlier;
}

/* Resets the information of lanes whose numbers have diverged. */
inline void reset_information(Lanes &l, M diverged) {
    for (int n = 0; n < FO_TRIANGLE; n++) l.info.U[n] = select(diverged, V{}, l.info.U[n]);
    for (int n = 0; n < 3; n++) l.info.noise[n] = select(diverged, V{}, l.info.noise[n]);
    for (int n = 0; n < FO_NX; n++) {
        l.info.z[n] = select(diverged, V{}, l.info.z[n]);
        l.info.d[n] = select(diverged, prior_information(l, n), l.info.d[n]);
        l.x[n] = select(diverged, V{}, l.x[n]);
    }
    l.innovation = select(diverged, V{}, l.innovation);
    l.power = select(diverged, all(ONE), l.power);
    l.lag_one = select(diverged, V{}, l.lag_one);
    l.noise_share = select(diverged, all(ONE), l.noise_share);
    l.rotation = select(diverged, V{}, l.rotation);
    l.trusted &= ~diverged;
    l.round_index &= ~diverged;
    l.restarts -= diverged; /* a mask is -1 */
}

/* Does the work of track (fluxobs_internal.h); the lanes `stopped` stop the tracker instead. */
inline void track(const fo_observer &o, Lanes &l, V theta, M stopped) {
    const fo_real h = o.sample_time;
    auto &t = l.tracker;
    const V turn_by = h * (t.speed + h * t.acceleration / TWO);
    const V predicted = wrapped(t.angle + turn_by), error = wrapped(theta - predicted);
    const M resumes = ~stopped & l.lost;
    const M follows = ~stopped & ~l.lost & (size(turn_by) <= PI);
    const M near = follows & (size(error) <= TRACKER_LOST);
    const V turned = wrapped(theta - t.angle) / h;
    l.lost = follows & ~near;
    t.angle = select(near, wrapped(predicted + o.track[0] * error), theta);
    t.speed = select(near, t.speed + (h * t.acceleration + o.track[1] * error),
                     select(resumes, turned, V{}));
    t.acceleration = select(near, t.acceleration + o.track[2] * error, V{});
    t.settled = select(l.lost, V{}, t.settled);
}

/* Processes an ordinary sample. */
inline void step(const fo_observer &o, Lanes &l, Sample &s, Estimates &e) {
    V p[2];
    for (int k = FO_HISTORY - 1; k > 0; k--)
        for (int i = 0; i < FO_N; i++) l.current[k][i] = l.current[k - 1][i];
    for (int i = 0; i < FO_N; i++) {
        l.current[0][i] = s.current[i];
        l.source[i] = s.source[i];
        l.volt_seconds[i] = s.t.v[i];
        l.held_source[i] = s.held_source[i];
        l.source_step[i] = s.source_step[i];
    }
    l.step = s.length;
    l.consecutive_bad = M{};

    predict(&o, &l.info, &s.t);
    measurement m = {s.rhs, all(ONE)};
    add_row<S>(l.info, s.row, m);
    const V innovation = root(m.weight) * m.rhs, share = o.h * innovation;
    V third[2], sums[2];
    for (int i = 0; i < FO_N; i++) {
        const V i0 = l.current[0][i], i1 = l.current[1][i], i2 = l.current[2][i],
                i3 = l.current[3][i];
        third[i] = third_difference(i0, i1, i2, i3);
        sums[i] = difference_of_sums(i0, i1, i2, i3);
    }
    l.power = o.rho * l.power + share * innovation;
    l.lag_one = o.rho * l.lag_one + share * l.innovation;
    l.innovation = innovation;
    l.info.noise[0] += o.noise_information * l.noise_inflation;
    l.noise_ratio += o.h * (inner(third, third) * o.over_noise - l.noise_ratio);
    l.noise_ratio_without_ripple +=
        o.h * ((fo_real)5 * inner(sums, sums) * o.over_noise - l.noise_ratio_without_ripple);
    const V least = select(l.noise_ratio < l.noise_ratio_without_ripple, l.noise_ratio,
                           l.noise_ratio_without_ripple);
    l.noise_inflation = select(least > ONE, least, all(ONE));

    solve(&l.info, l.x);
    V square = position_vector(o, l, &l.x[FLUX], p);
    const M diverged = ~(square < RUNAWAY); /* also NaN; happens after a long standstill */
    if (any(diverged)) {
        reset_information(l, diverged);
        square = position_vector(o, l, &l.x[FLUX], p);
    }
    const M turn = l.round_index;
    l.round_index = turn + 1;
    l.round_index &= l.round_index < static_cast<integer>(REINJECT_PERIOD);
    V theta = atan2_of(p[1], p[0]);
    const M long_enough = square > o.square_min;
    const M judging = (turn & 1) != 0;
    if (any(~judging)) reinject_due(o, l, turn);
    if (any(judging)) update_variances(l, p, square, judging, long_enough);
    const M known = long_enough & (l.noise_share < SHARE_LIMIT);
    l.rotation = select(known, l.rotation + wrapped(theta - l.theta), V{});
    l.theta = theta;
    const M trusted = known & (l.trusted | (size(l.rotation) > SWEEP));

    const V turned = size(l.tracker.speed) * o.sample_time;
    l.voltage_turn +=
        o.h * o.drift_prior_std - l.voltage_turn * select(turned < ONE, turned, all(ONE));
    l.voltage_turn =
        select(l.voltage_turn < VOLTAGE_TURN_MAX, l.voltage_turn, all(VOLTAGE_TURN_MAX));

    V variance = l.angle_variance + o.position_noise * l.noise_inflation / square + ZERO;
    l.variance = select(trusted, variance, l.variance);
    l.open_loop_time = select(trusted, V{}, l.open_loop_time);
    const M carrying = ~trusted & l.have_trusted_flux;
    l.have_trusted_flux |= trusted;
    variance = select(trusted, variance, all(VARIANCE_UNKNOWN));
    for (int i = 0; i < FO_N; i++) {
        e.flux[i] = l.x[FLUX + i];
        e.drift[i] = l.x[DRIFT + i];
        l.flux[i] = select(trusted, e.flux[i], l.flux[i]);
        l.drift[i] = select(trusted, e.drift[i], l.drift[i]);
    }
    if (any(carrying)) {
        const V carried = integrate_open_loop(o, l, s.t.v, carrying);
        const M report = carrying & (~known | (carried < VARIANCE_UNKNOWN));
        variance = select(carrying, carried, variance);
        const V there = position_vector(o, l, l.flux, p);
        square = select(report, there, square);
        theta = select(report, atan2_of(p[1], p[0]), theta);
        for (int i = 0; i < FO_N; i++) {
            e.flux[i] = select(report, l.flux[i], e.flux[i]);
            e.drift[i] = select(report, l.drift[i], e.drift[i]);
        }
    }
    const M lost = ~(variance < VARIANCE_UNKNOWN);
    variance = select(lost, all(VARIANCE_UNKNOWN), variance);

    track(o, l, theta, lost & ~known);
    const auto &t = l.tracker;

    l.length = root(square);
    l.trusted = trusted;
    e.theta_e_std = root(variance);
    const M near = size(wrapped(theta - t.angle)) < STD_LIMIT + (fo_real)3 * e.theta_e_std;
    const V settled = t.settled + select(near, all(o.h), all(TRACKER_OFF * o.h));
    l.tracker.settled =
        select(trusted, select(t.settled < TRACKER_SETTLED, settled, t.settled), V{});

    for (int i = 0; i < FO_N; i++) {
        e.flux[i] *= o.flux_base;
        e.drift[i] *= o.drift_base;
    }
    e.psi_f = l.length * o.flux_base;
    e.theta_e = theta;
    e.theta_e_tracked = t.angle;
    e.speed_e = t.speed;
    e.innovation = l.innovation;
    e.noise_share = l.noise_share;
    e.valid = trusted & (t.settled >= TRACKER_SETTLED) & (variance < STD_LIMIT * STD_LIMIT) &
              (l.voltage_turn < VOLTAGE_LIMIT * l.length);
}

/* One row of every record: [records][rows][2]. */
inline void read(const double *from, size_t rows, size_t row, V to[2]) {
#if defined(__AVX2__) && FO_SINGLE
    __m128 pairs[4]; /* of records k and k + 1 */
    for (int k = 0; k < 4; k++) {
        const double *one = from + 2 * (static_cast<size_t>(2 * k) * rows + row);
        const __m256d both = _mm256_insertf128_pd(_mm256_castpd128_pd256(_mm_loadu_pd(one)),
                                                  _mm_loadu_pd(one + 2 * rows), 1);
        /* a number beyond the range of single precision becomes infinite, and is not rounded to the
         * largest one */
        const __m256d sign = _mm256_and_pd(both, _mm256_set1_pd(-0.0));
        const __m256d most = _mm256_set1_pd(3.4028234663852886e38);
        const __m256d beyond = _mm256_cmp_pd(_mm256_xor_pd(both, sign), most, _CMP_GT_OQ);
        const __m256d endless = _mm256_or_pd(_mm256_set1_pd(__builtin_inf()), sign);
        pairs[k] = _mm256_cvtpd_ps(_mm256_blendv_pd(both, endless, beyond));
    }
    for (int n = 0; n < 2; n++) {
        const __m128 low =
            n ? _mm_shuffle_ps(pairs[0], pairs[1], 0xDD) : _mm_shuffle_ps(pairs[0], pairs[1], 0x88);
        const __m128 high =
            n ? _mm_shuffle_ps(pairs[2], pairs[3], 0xDD) : _mm_shuffle_ps(pairs[2], pairs[3], 0x88);
        to[n] = reinterpret_cast<V>(_mm256_set_m128(high, low));
    }
#else
    for (int k = 0; k < LANES; k++)
        for (int n = 0; n < 2; n++) {
            const double x =
                from[2 * (static_cast<size_t>(k) * rows + row) + static_cast<size_t>(n)];
            /* a number beyond the range of single precision becomes infinite */
            const double most =
                sizeof(fo_real) < sizeof x ? 3.4028234663852886e38 : __builtin_inf();
            to[n][k] = static_cast<fo_real>(x > most    ? __builtin_inf()
                                            : x < -most ? -__builtin_inf()
                                                        : x);
        }
#endif
}

/* Number of rows that are written together. Each column of a record is in its own memory pages:
 * single rows would access all these pages again and again. */
constexpr size_t TILE = 64;

/* Prefetches a part of the memory for the next tile, because the processor's own prefetch cannot
 * follow so many places at once. */
inline void prefetch(const double *next, size_t rows, size_t plane, size_t place) {
    const double *at = next + (place % LANES) * rows + place / LANES * (64 / sizeof(double));
    if (place / LANES < TILE * sizeof(double) / 64)
        for (size_t n = 0; n < COLUMNS; n++) __builtin_prefetch(at + plane * n, 1);
}

/* Writes a column's last rows; `rows` is the number of rows of a record. */
inline void write(const V tile[TILE], double *to, size_t rows, size_t count) {
    size_t r = 0;
#if defined(__AVX2__)
    for (; r + 4 <= count; r += 4) { /* transpose four rows of four records */
        for (int first = 0; first < LANES; first += 4) {
            __m256d of[4];
            for (size_t n = 0; n < 4; n++) {
#if FO_SINGLE
                const __m256 row = reinterpret_cast<__m256>(tile[r + n]);
                of[n] = _mm256_cvtps_pd(first ? _mm256_extractf128_ps(row, 1)
                                              : _mm256_castps256_ps128(row));
#else
                of[n] = reinterpret_cast<__m256d>(tile[r + n]);
#endif
            }
            const __m256d a = _mm256_unpacklo_pd(of[0], of[1]),
                          b = _mm256_unpackhi_pd(of[0], of[1]);
            const __m256d c = _mm256_unpacklo_pd(of[2], of[3]),
                          d = _mm256_unpackhi_pd(of[2], of[3]);
            double *at = to + static_cast<size_t>(first) * rows + r;
            _mm256_storeu_pd(at, _mm256_permute2f128_pd(a, c, 0x20));
            _mm256_storeu_pd(at + rows, _mm256_permute2f128_pd(b, d, 0x20));
            _mm256_storeu_pd(at + 2 * rows, _mm256_permute2f128_pd(a, c, 0x31));
            _mm256_storeu_pd(at + 3 * rows, _mm256_permute2f128_pd(b, d, 0x31));
        }
    }
#endif
    for (; r < count; r++)
        for (int k = 0; k < LANES; k++) to[static_cast<size_t>(k) * rows + r] = tile[r][k];
}

}  // namespace

bool lanes_here() {
#if defined(__x86_64__)
    return __builtin_cpu_supports("avx2");
#else
    return true;
#endif
}

void lanes_run(const fo_observer *observer, fo_state *states, const double *voltage,
               const double *current, size_t rows, double *columns, size_t plane, bool *valid) {
    const fo_observer &o = *observer;
    Lanes now;
    __builtin_memset(&now, 0, sizeof now);
    V tile[COLUMNS][TILE]; /* estimates of the last rows */
    bool scalar[LANES];    /* whether the state is in `states`, otherwise in `now` */
    for (int k = 0; k < LANES; k++) scalar[k] = true;

    for (size_t row = 0; row < rows; row++) {
        V u[2], i[2];
        Sample sample;
        Estimates estimates;
        read(voltage, rows, row, u);
        read(current, rows, row, i);
        prepare_sample(o, now, u, i, sample);
        for (int k = 0; k < LANES; k++) {
            if (scalar[k] || sample.irregular[k] == 0) continue;
            store(o, now, k, states[k]);
            scalar[k] = true;
        }
        step(o, now, sample, estimates);
        const size_t place = row % TILE;
        size_t count = 0;
#define KEEP_VECTOR(name) \
    for (int n = 0; n < FO_N; n++) tile[count++][place] = estimates.name[n];
#define KEEP_NUMBER(name) tile[count++][place] = estimates.name;
        FO_ESTIMATE_FIELDS(KEEP_VECTOR, KEEP_NUMBER)
        for (int k = 0; k < LANES; k++) {
            bool &known = valid[static_cast<size_t>(k) * rows + row];
            known = estimates.valid[k] != 0;
            if (!scalar[k]) continue;
            const fo_real voltage_of[2] = {u[0][k], u[1][k]}, current_of[2] = {i[0][k], i[1][k]};
            fo_estimate e;
            fo_step(observer, &states[k], voltage_of, current_of, &e);
            known = e.valid;
            count = 0;
#define KEEP_VECTOR_OF(name) \
    for (int n = 0; n < FO_N; n++) tile[count++][place][k] = e.name[n];
#define KEEP_NUMBER_OF(name) tile[count++][place][k] = e.name;
            FO_ESTIMATE_FIELDS(KEEP_VECTOR_OF, KEEP_NUMBER_OF)
            if (is_regular(states[k])) {
                load(now, k, states[k]);
                scalar[k] = false;
            }
        }
        if (row - place + 2 * TILE <= rows) prefetch(columns + row - place + TILE, rows, plane, place);
        if (place == TILE - 1 || row == rows - 1)
            for (size_t n = 0; n < COLUMNS; n++)
                write(tile[n], columns + plane * n + row - place, rows, place + 1);
    }
    for (int k = 0; k < LANES; k++)
        if (!scalar[k]) store(o, now, k, states[k]);
}

#endif
