/* SPDX-License-Identifier: MIT */
#include "fluxobs_seed.h"

#include "fluxobs_internal.h"
#if FO_ADAPTIVE
#include "fluxobs_learning.h"
#include "fluxobs_relation.h"
#endif

#include <string.h>

/* Default std of the length, as a share of it [1]: a quarter, as for a magnet flux from a data
 * sheet. */
static const fo_real LENGTH_SHARE = (fo_real)0.25;
/* Smallest std of a seed's angle [rad]: no sensor is mounted to better than 0.06 degrees. The
 * information of a smaller std exceeds single precision. */
static const fo_real STD_MIN = (fo_real)1e-3;

/* Largest std of an angle that enters the least squares [rad]: 20 degrees. A less certain angle is
 * only integrated. With half a radian, 3 of 60 starts of an induction machine were sure and wrong,
 * by up to 15 degrees (benchmarks/seeds.py has Hall sensors, 17 degrees). */
static const fo_real ROUGH_STD = (fo_real)0.35;

#if FO_ADAPTIVE
/* Negligible information that keeps the factor regular [1 / flux bases^2]. */
static const fo_real SEED_INFORMATION_MIN = (fo_real)1e-6;
#endif

/* The seed, per-unit. */
typedef struct {
    fo_real theta, std;          /* [rad] */
    fo_real length, length_std;
    fo_real direction[FO_N];     /* direction of the rotor */
    fo_real flux[FO_N];
} seed_point;

static void per_unit(const fo_observer *o, const fo_seed *seed, seed_point *point)
{
    const fo_real length = seed->psi_f / o->flux_base;
    point->theta = wrap(seed->theta_e);
    point->std = seed->theta_e_std > STD_MIN ? seed->theta_e_std : STD_MIN;
    point->length = fo_abs(length) > ZERO ? length : ONE;
    const fo_real share = seed->psi_f_std / o->flux_base;
    point->length_std = share > ZERO ? share : LENGTH_SHARE * fo_abs(point->length);
    direction_of(point->theta, point->direction);
}

/* The observer's angle is that of the position vector. A negative length turns the vector by half a
 * turn. */
static void make_length_positive(seed_point *point)
{
    if (point->length < ZERO) {
        point->theta = wrap(point->theta + PI);
        point->length = -point->length;
        point->direction[0] = -point->direction[0];
        point->direction[1] = -point->direction[1];
    }
}

/* Measurement row of the seed, either across the position vector or along it. */
static void row_of_seed(const seed_point *point, bool along, fo_real row[FO_N],
                        fo_real *information) {
    const fo_real curved = point->length * point->std * point->std / TWO; /* an arc, not a line */
    const fo_real lengthwise = fo_sqrt(point->length_std * point->length_std + curved * curved);
    const fo_real std = along ? lengthwise : point->length * point->std;
    row[0] = along ? point->direction[0] : -point->direction[1];
    row[1] = along ? point->direction[1] : point->direction[0];
    *information = ONE / (std * std);
}

/* Can an observer start from this seed? */
static bool is_usable(const fo_observer *o, const fo_seed *seed, const seed_point *point,
                   const fo_real current[FO_N])
{
    const fo_real square = point->length * point->length, most = (fo_real)1e3; /* flux bases */
    const fo_real all = seed->theta_e + seed->theta_e_std + seed->speed_e + seed->psi_f +
                        seed->psi_f_std + seed->weight_other;
    return all - all == ZERO && seed->theta_e_std > ZERO &&
           within(seed->theta_e, -TWO * PI, TWO * PI) &&
           within(seed->weight_other, ZERO, ONE / TWO) && square > o->square_min &&
           square < most * most && dot(current, current) <= o->current_limit * o->current_limit;
}

/* Starts the plain observer. */
static void start_plain(const fo_observer *o, fo_state *s, const fo_seed *seed,
                     const fo_real current[FO_N], seed_point *point)
{
    make_length_positive(point);
    for (int k = 0; k < (int)FO_HISTORY; k++) {
        s->current[k][0] = current[0];
        s->current[k][1] = current[1];
    }
    s->have_current = true;
    s->tracker.angle = point->theta;
    s->tracker.speed = seed->speed_e;
    s->theta = point->theta;
    s->length = point->length;
#if FO_MAPPED
    for (int i = 0; i < FO_N; i++) {
        s->map_point.armature_flux[i] = o->L_position * current[i];
    }
    if (has_map(o)) {
        fo_linearise_map(o, point->theta, current, &s->map_point);
    }
    s->previous_point = s->map_point;
#endif
    for (int i = 0; i < FO_N; i++) {
        point->flux[i] = point->length * point->direction[i] + armature_flux(o, s, i);
        s->flux[i] = point->flux[i];
    }
    if (point->std < ROUGH_STD) {
        for (int along = 0; along < 2; along++) {
            fo_real row[FO_NX] = {0}, information;
            row_of_seed(point, along == 1, &row[FLUX], &information);
            (void)fo_add_row(&s->info, row, dot(&row[FLUX], point->flux), information, (int)FLUX);
        }
    }
    s->have_trusted_flux = true; /* integrate the flux from here */
    s->variance = point->std * point->std;
}

/* Resets the plain observer's state. Starts the observer if the seed is usable; returns whether the
 * seed is usable. */
static bool seed_plain(const fo_observer *o, fo_state *s, const fo_seed *seed,
                       const fo_real current[FO_N], seed_point *point)
{
    fo_reset(o, s);
    per_unit(o, seed, point);
    const bool good = is_usable(o, seed, point, current);
    if (good) {
        start_plain(o, s, seed, current, point);
    }
    return good;
}

void fo_seed_state(const fo_observer *o, fo_state *s, const fo_seed *seed,
                   const fo_real current[FO_N])
{
    seed_point point;
    (void)seed_plain(o, s, seed, current, &point);
}

#if FO_ADAPTIVE
/* Starts the adaptive observer's filter from the seed. */
static void start_filter(const fo_adaptive *a, fo_adaptive_state *s, const seed_point *seed,
                         const fo_real current[FO_N])
{
    seed_point point;
    fo_candidate c;
    fo_manifold m;
    const fo_observer *o = &a->plain;
    point = *seed;

    fo_block_end end;
    (void)memset(&end, 0, sizeof end);
#if FO_MAPPED
    end.map_point = s->plain.map_point;
    s->map_point = s->plain.map_point;
#endif
    /* The filter's flux includes the estimated errors of inductance and offsets. */
    fo_linearisation with_errors;
    fo_linearise(a, s->value, point.flux, current, map_of(&end), &with_errors);
    for (int i = 0; i < FO_N; i++) {
        point.flux[i] += point.length * point.direction[i] - with_errors.x[i];
    }
    (void)memset(&c, 0, sizeof c);
    (void)memset(&m, 0, sizeof m);
    const fo_real known = o->drift_prior_std, twice = TWO * point.length * point.length_std;
    for (int i = 0; i < FO_N; i++) {
        c.p[i] = point.flux[i];
        m.d[i] = SEED_INFORMATION_MIN;
        m.d[FO_N + i] = ONE / (known * known);
    }
    c.p[FO_NM - 1] = point.length * point.length;
    m.d[FO_NM - 1] = ONE / (twice * twice);
    c.theta = point.theta;
    c.variance = point.std * point.std;
    for (int along = 0; along < 2; along++) {
        fo_real row[FO_NM] = {0}, value = ZERO, information;
        row_of_seed(&point, along == 1, row, &information);
        fo_add_row_to(FO_NM, m.U, m.d, m.z, 0, FO_NM, row, &value, &information);
    }
    /* No error has turned the flux yet. The std of the voltage holds until the first block ends. */
    fo_learner *r = &s->learner;
    for (int i = 0; i < FO_N; i++) {
        end.flux[i] = c.p[i];
        end.current[i] = current[i];
        s->flux[i] = c.p[i];
    }
    end.speed = s->plain.tracker.speed;
    const fo_real drop = a->std[FO_RESISTANCE] * fo_sqrt(dot(current, current));
    const fo_real loss = a->std[FO_INVERTER] * TWO;
    fo_learning_start(a, r, &c, &m, ONE, &end);
    r->report.voltage_std = fo_sqrt(drop * drop + loss * loss) * a->volt / o->h;
    r->report.voltage_std_square = dot(current, current);
    r->report.growth = r->report.voltage_std * r->report.voltage_std;
    fo_learning_values(a, r, s->value);
    s->report = r->report;
    s->tracker = s->plain.tracker;
    s->emf_ratio = ZERO;
    s->theta = point.theta;
    s->x[0] = point.direction[0];
    s->x[1] = point.direction[1];
    s->running = true;
    s->place = false;
    s->std = point.std;
    s->reason = FO_UNCERTAIN;
}

void fo_adaptive_seed_state(const fo_adaptive *a, fo_adaptive_state *s, const fo_seed *seed,
                            const fo_real current[FO_N])
{
    seed_point point;
    if (is_never_reset(&s->plain)) {
        fo_adaptive_reset(a, s);
    } else {
        fo_adaptive_restart(a, s, s->learner.frozen);
    }
    s->seeded = seed_plain(&a->plain, &s->plain, seed, current, &point);
    s->half_turn = s->seeded ? seed->weight_other : ZERO;
    if (s->seeded && point.std < START_STD && !has_cage_map(&a->plain)) {
        start_filter(a, s, &point, current);
    } else if (s->seeded) { /* too uncertain for the filter: the first candidate is here */
        s->x[0] = point.direction[0];
        s->x[1] = point.direction[1];
    } else {
        /* the seed is unusable: the state is only reset */
    }
}
#endif
