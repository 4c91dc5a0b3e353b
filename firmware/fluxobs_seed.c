/* SPDX-License-Identifier: MIT */
#include "fluxobs_seed.h"

#include "fluxobs_internal.h"
#if FO_ADAPTIVE
#include "fluxobs_learning.h"
#endif

#include <string.h>

/* Std of a length that is not given: a quarter, as for a magnet flux from a data sheet [1]. */
static const fo_real LENGTH_SHARE = (fo_real)0.25;
/* Least std of an angle that is taken over [rad]: no sensor is mounted better than to 0.06 degrees,
 * and information without end leaves single precision. */
static const fo_real STD_LEAST = (fo_real)1e-3;

/* Std of an angle beyond which it is only carried on, and tells the least squares nothing: 20 degrees
 * [rad]. Half a radian made 3 of 60 starts of an induction machine sure and wrong, up to 15 degrees
 * (benchmarks/seeds.py has Hall sensors, 17 degrees). */
static const fo_real ROUGH = (fo_real)0.35;

#if FO_ADAPTIVE
/* Information that is next to nothing, and keeps the triangle regular [1 / flux bases^2]. */
static const fo_real NOTHING = (fo_real)1e-6;
#endif

/* The seed, per-unit. */
typedef struct {
    fo_real theta, std;          /* [rad] */
    fo_real length, length_std;
    fo_real along[FO_N];         /* direction of the rotor */
    fo_real flux[FO_N];
} start;

static void per_unit(const fo_observer *o, const fo_seed *seed, start *at)
{
    const fo_real length = seed->psi_f / o->flux_base;
    at->theta = wrap(seed->theta_e);
    at->std = seed->theta_e_std > STD_LEAST ? seed->theta_e_std : STD_LEAST;
    at->length = fo_abs(length) > ZERO ? length : ONE;
    const fo_real share = seed->psi_f_std / o->flux_base;
    at->length_std = share > ZERO ? share : LENGTH_SHARE * fo_abs(at->length);
    /* the cosine and sine of the angle: half of it is within a quarter turn */
    const fo_real axis[FO_N] = {ONE, ZERO};
    fo_real quarter[FO_N], half[FO_N];
    turn(axis, at->theta / (fo_real)4, quarter);
    turn(quarter, at->theta / (fo_real)4, half);
    at->along[0] = half[0] * half[0] - half[1] * half[1];
    at->along[1] = TWO * half[0] * half[1];
}

/* Where the position vector points backwards, so does what the observer calls the angle. */
static void face_forward(start *at)
{
    if (at->length < ZERO) {
        at->theta = wrap(at->theta + PI);
        at->length = -at->length;
        at->along[0] = -at->along[0];
        at->along[1] = -at->along[1];
    }
}

/* The rows that the seed is worth: across the position vector, and along it. */
static void row_of_seed(const start *at, bool along, fo_real row[FO_N], fo_real *information)
{
    const fo_real bent = at->length * at->std * at->std / TWO; /* a turn is no straight line */
    const fo_real lengthwise = fo_sqrt(at->length_std * at->length_std + bent * bent);
    const fo_real std = along ? lengthwise : at->length * at->std;
    row[0] = along ? at->along[0] : -at->along[1];
    row[1] = along ? at->along[1] : at->along[0];
    *information = ONE / (std * std);
}

/* Can an observer start from it? */
static bool usable(const fo_observer *o, const fo_seed *seed, const start *at,
                   const fo_real current[FO_N])
{
    const fo_real square = at->length * at->length, most = (fo_real)1e3; /* flux bases */
    const fo_real all = seed->theta_e + seed->theta_e_std + seed->speed_e + seed->psi_f +
                        seed->psi_f_std;
    return all - all == ZERO && seed->theta_e_std > ZERO && within(seed->theta_e, -TWO * PI, TWO * PI) &&
           square > o->square_min && square < most * most &&
           dot(current, current) <= o->current_limit * o->current_limit;
}

/* The plain observer's start. */
static void begin_at(const fo_observer *o, fo_state *s, const fo_seed *seed,
                     const fo_real current[FO_N], start *at)
{
    face_forward(at);
    for (int k = 0; k < (int)FO_HISTORY; k++) {
        s->current[k][0] = current[0];
        s->current[k][1] = current[1];
    }
    s->have_current = true;
    s->tracker.angle = at->theta;
    s->tracker.speed = seed->speed_e;
    s->theta = at->theta;
    s->length = at->length;
#if FO_MAPPED
    for (int i = 0; i < FO_N; i++) {
        s->shape.away[i] = o->L_position * current[i];
    }
    if (mapped(o)) {
        fo_ask_map(o, at->theta, current, &s->shape);
    }
    s->before = s->shape;
#endif
    for (int i = 0; i < FO_N; i++) {
        at->flux[i] = at->length * at->along[i] + away(o, s, i);
        s->flux[i] = at->flux[i];
    }
    if (at->std < ROUGH) {
        for (int along = 0; along < 2; along++) {
            fo_real row[FO_NX] = {0}, information;
            row_of_seed(at, along == 1, &row[FLUX], &information);
            (void)fo_rotate_in(&s->info, row, dot(&row[FLUX], at->flux), information, (int)FLUX);
        }
    }
    s->have_carried = true; /* the flux is carried on from here */
    s->variance = at->std * at->std;
}

/* The same where it can be, else the state is only reset. Says what it has started from. */
static bool seed_plain(const fo_observer *o, fo_state *s, const fo_seed *seed,
                       const fo_real current[FO_N], start *at)
{
    fo_reset(o, s);
    per_unit(o, seed, at);
    const bool good = usable(o, seed, at, current);
    if (good) {
        begin_at(o, s, seed, current, at);
    }
    return good;
}

void fo_seed_state(const fo_observer *o, fo_state *s, const fo_seed *seed,
                   const fo_real current[FO_N])
{
    start at;
    (void)seed_plain(o, s, seed, current, &at);
}

#if FO_ADAPTIVE
/* The filter starts there. */
static void start_filter(const fo_adaptive *a, fo_adaptive_state *s, const start *seed,
                         const fo_real current[FO_N])
{
    start at;
    fo_candidate c;
    fo_manifold m;
    const fo_observer *o = &a->plain;
    at = *seed;

    /* What is learnt of the inductance and of the offsets is in the filter's flux. */
    const fo_real wrong = fo_learning_value(a, s, FO_INDUCTANCE + 1);
    for (int i = 0; i < FO_N; i++) {
        const fo_real offset = fo_learning_value(a, s, FO_OFFSET + i);
        if (!mapped(o)) {
            at.flux[i] += o->L_position * (wrong * (current[i] - offset) - offset);
        }
    }
    (void)memset(&c, 0, sizeof c);
    (void)memset(&m, 0, sizeof m);
    const fo_real known = o->plausible, twice = TWO * at.length * at.length_std;
    for (int i = 0; i < FO_N; i++) {
        c.p[i] = at.flux[i];
        m.d[i] = NOTHING;
        m.d[FO_N + i] = ONE / (known * known);
    }
    c.p[FO_NM - 1] = at.length * at.length;
    m.d[FO_NM - 1] = ONE / (twice * twice);
    c.theta = at.theta;
    c.variance = at.std * at.std;
    for (int along = 0; along < 2; along++) {
        fo_real row[FO_NM] = {0}, value = ZERO, information;
        row_of_seed(&at, along == 1, row, &information);
        fo_rotate(FO_NM, m.U, m.d, m.z, 0, FO_NM, row, &value, &information);
    }
    fo_effects none;
    (void)memset(&none, 0, sizeof none);
    s->tracker = s->plain.tracker;
    s->doubt = ZERO; /* nothing has turned the flux yet */
    fo_learning_start(a, s, &c, &m, ONE, &none);

    /* Voltage by which the parameters may be off, until the first block ends. */
    const fo_real drop = a->std[FO_RESISTANCE] * fo_sqrt(dot(current, current));
    const fo_real loss = a->std[FO_INVERTER] * TWO;
    s->unsure = fo_sqrt(drop * drop + loss * loss) * a->volt / o->h;
    s->unsure_at = dot(current, current);
}

void fo_adaptive_seed_state(const fo_adaptive *a, fo_adaptive_state *s, const fo_seed *seed,
                            const fo_real current[FO_N])
{
    start at;
    if (never_reset(&s->plain)) {
        fo_adaptive_reset(a, s);
    } else {
        fo_adaptive_restart(a, s, s->frozen);
    }
    s->seeded = seed_plain(&a->plain, &s->plain, seed, current, &at);
    if (s->seeded && at.std < START_STD && !mapped(&a->plain)) {
        start_filter(a, s, &at, current);
    } else if (s->seeded) { /* too rough to learn from: positions are followed, the first from here */
        s->x[0] = at.along[0];
        s->x[1] = at.along[1];
        fo_candidates_sow(a, s);
    } else {
        /* it starts from nothing */
    }
}
#endif
