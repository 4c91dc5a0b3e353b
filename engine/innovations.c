#include "innovations.h"

#include <math.h>
#include <string.h>

#include "dual.h"
#include "transition.h"

enum { A = FO_ALPHA, B = FO_BETA, S = FO_STATES };

/* Columns of the derivatives of the states. */
enum {
    POLE = FO_L_colour_pole - FO_LEVELS,
    GAIN = FO_L_colour_gain - FO_LEVELS,
    MODEL = FO_FIRST_OF_MODEL - FO_LEVELS,
    MEANS = FO_FIRST_OF_MEANS - FO_LEVELS
};

#ifndef FO_VALUES_ONLY
const unsigned char fo_measured_states[FO_BY] = {FO_FLUX, FO_FLUX + 1, FO_ANGLE, FO_PSI};
#endif

/* Where the elements of a kind begin. */
enum {
    OF_FLUX = 0,
    FLUX_WIDTH = 7,
    OF_SPEED = 14,
    OWN_ANGLE = 18,
    OWN_PSI = 19,
    OF_CAGE = 20, /* slip and rotor flux follow the current */
    OF_TIME = FO_BENT,
    OF_NOISE = 33,
    NOISE_WIDTH = 5
};
#ifndef FO_VALUES_ONLY
const unsigned char fo_pattern[FO_ELEMENTS][2] = {
    {0, 0}, {0, 1}, {0, FO_ANGLE}, {0, FO_SPEED}, {0, FO_PSI}, {0, FO_DRIFT}, {0, FO_DRIFT + 1},
    {1, 0}, {1, 1}, {1, FO_ANGLE}, {1, FO_SPEED}, {1, FO_PSI}, {1, FO_DRIFT}, {1, FO_DRIFT + 1},
    {FO_SPEED, 0}, {FO_SPEED, 1}, {FO_SPEED, FO_ANGLE}, {FO_SPEED, FO_PSI},
    {FO_ANGLE, FO_ANGLE}, {FO_PSI, FO_PSI},
    {FO_ANGLE, 0}, {FO_ANGLE, 1}, {FO_ANGLE, FO_PSI}, {FO_PSI, 0}, {FO_PSI, 1}, {FO_PSI, FO_ANGLE},
    {FO_ANGLE, FO_SPEED}, {FO_ANGLE, FO_ACCELERATION}, {FO_SPEED, FO_SPEED},
    {FO_SPEED, FO_ACCELERATION}, {FO_ACCELERATION, FO_ACCELERATION}, {FO_DRIFT, FO_DRIFT},
    {FO_DRIFT + 1, FO_DRIFT + 1},
    {FO_NOISE, FO_NOISE}, {FO_NOISE, 0}, {FO_NOISE, 1}, {FO_NOISE, FO_ANGLE}, {FO_NOISE, FO_PSI},
    {FO_NOISE + 1, FO_NOISE + 1}, {FO_NOISE + 1, 0}, {FO_NOISE + 1, 1}, {FO_NOISE + 1, FO_ANGLE},
    {FO_NOISE + 1, FO_PSI}};
#endif

fo_elements fo_elements_of(const fo_model *m)
{
    fo_elements e = {{0}, 0, m->is_coloured ? S : FO_NOISE};
    for (int k = 0; k < FO_ELEMENTS; k++) {
        if (k >= OF_CAGE && k < OF_TIME && !m->machine.cage) continue;
        if (k >= OF_NOISE && !m->is_coloured) continue;
        e.at[e.count++] = (unsigned char)k;
    }
    return e;
}

/* Derivatives of the filter by a level or the colour: through the gain, they move the state. */
typedef struct {
    double x[S], P[S][S];
} by_variance;

/* What a pass over the rows needs. */
typedef struct {
    const fo_log *log;
    const fo_course *course; /* of the row, and the next */
    const fo_model *m;
    fo_elements elements;
    bool sensitive;         /* derivatives of the states are wanted */
    bool direct;            /* those of each step, what it starts from held, are kept */
    bool of_course;         /* those of the course, without those of F and H times the state's distance from it */
    by_variance *variances; /* or null */
    int variances_count;    /* without colour: the levels */
    size_t skipped;
    fo_likelihood *out;     /* or null */
    const fo_follower *follower; /* the course follows the filter; or null */
    fo_course *followed;    /* the same rows as `course`, to write */
    double load_step;       /* variance of the acceleration by which a load step changes it */
} pass;

/* A measurement update. */
typedef struct {
    double noise[2][2], R[2][2]; /* R: with that of rounding */
    double e[2], V[2][2], w[2], K[S][2]; /* V: inverse of the covariance S of e; w = V e */
    double det;                          /* of S */
    fo_dual H[2][FO_BY];
    double by_model[2][FO_T]; /* derivatives of e, of the state held */
    double angle;             /* of the state before it, from the course */
} update;

static void start_at(const fo_problem *q, const fo_model *m, fo_filter *f)
{
    const fo_start *start = q->start;
    const fo_course *course = q->course;
    memset(f, 0, sizeof *f);
    f->turning =
        q->log->rows > 1 ? (course[1].angle - course[0].angle) / q->log->sample_time : 0.0;
    f->x[FO_FLUX] = course->flux[A];
    f->x[FO_FLUX + 1] = course->flux[B];
    f->x[FO_ANGLE] = course->angle;
    f->x[FO_SPEED] = f->turning;
    f->x[FO_PSI] = course->psi;
    const double stds[FO_NOISE] = {start->flux_std,  start->flux_std,  start->angle_std,
                                   start->speed_std, start->psi_std,   start->acceleration_std,
                                   start->drift_std, start->drift_std};
    for (int r = 0; r < FO_NOISE; r++) f->P[r][r] = stds[r] * stds[r];
    for (int r = FO_NOISE; r < S; r++) f->P[r][r] = m->colour * m->colour * m->noise;
}

/* The state's distance from the course. */
static void deviation(const fo_course *at, const double x[S], double d[FO_BY])
{
    d[FO_BY_ALPHA] = x[FO_FLUX] - at->flux[A];
    d[FO_BY_BETA] = x[FO_FLUX + 1] - at->flux[B];
    d[FO_BY_ANGLE] = x[FO_ANGLE] - at->angle;
    d[FO_BY_PSI] = x[FO_PSI] - at->psi;
}

/* Derivatives of the measured current. */
static void measured_slope(const fo_prediction *p, fo_dual H[2][FO_BY])
{
    memcpy(H, p->slope, sizeof p->slope);
    if (!p->clipped) return;
    for (int a = 0; a < 2; a++)
        for (int k = 0; k < FO_BY; k++)
            H[a][k] = fo_axpy(fo_scale(p->sensed[a][A], p->slope[A][k]), p->sensed[a][B],
                              p->slope[B][k]);
}

/* A saturated sensor hides its noise too, except for this share of the variance, which the converter
 * adds. Assumed. */
static const double behind = 0.1;

static double noise_of(const fo_prediction *p, int a, int b)
{
    if (!p->clipped) return a == b ? 1.0 : 0.0;
    const double passed = p->sensed[a][A] * p->sensed[b][A] + p->sensed[a][B] * p->sensed[b][B];
    return (1.0 - behind) * passed + (a == b ? behind : 0.0);
}

/* B ← P Hᵀ; the noise's states are added to the current. */
static void times_slope(double P[S][S], double H[2][FO_BY], double out[S][2])
{
    for (int a = 0; a < 2; a++) {
        const double *h = H[a];
        for (int r = 0; r < S; r++)
            out[r][a] = P[r][FO_FLUX] * h[FO_BY_ALPHA] + P[r][FO_FLUX + 1] * h[FO_BY_BETA] +
                        P[r][FO_ANGLE] * h[FO_BY_ANGLE] + P[r][FO_PSI] * h[FO_BY_PSI] +
                        P[r][FO_NOISE + a];
    }
}

static double slope_times(double H[2][FO_BY], int a, double x[S][2], int b)
{
    double sum = x[FO_NOISE + a][b];
    for (int k = 0; k < FO_BY; k++) sum += H[a][k] * x[fo_measured_states[k]][b];
    return sum;
}

/* Normalised square of an innovation, of which one row in fifty has a larger one: e^{−4}. */
static const double unlikely = 4.0;

/* Measurement update of the derivatives by levels and colour, with ∂K = (∂(P Hᵀ) − K ∂S) S⁻¹, and their
 * part of the information, ∂eᵀ S⁻¹ ∂e + ½ tr(S⁻¹ ∂S S⁻¹ ∂S). */
static void measure_variances(const pass *q, double H[2][FO_BY], const update *z, bool counted)
{
    double VS[FO_VARIANCES][2][2], e[FO_VARIANCES][2];
    for (int l = 0; l < q->variances_count; l++) {
        by_variance *own = q->variances + l;
        double PH[S][2], by[2][2];
        times_slope(own->P, H, PH);
        for (int a = 0; a < 2; a++) {
            e[l][a] = -own->x[FO_NOISE + a];
            for (int k = 0; k < FO_BY; k++) e[l][a] -= H[a][k] * own->x[fo_measured_states[k]];
            for (int b = 0; b < 2; b++)
                by[a][b] = slope_times(H, a, PH, b) + (l == FO_L_noise ? 2.0 * z->noise[a][b] : 0.0);
        }
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++)
                VS[l][a][b] = z->V[a][0] * by[0][b] + z->V[a][1] * by[1][b];
        for (int r = 0; r < S; r++) {
            const double k = z->K[r][0], n = z->K[r][1];
            const double x = k * by[0][0] + n * by[1][0] - PH[r][0];
            const double y = k * by[0][1] + n * by[1][1] - PH[r][1];
            own->x[r] += k * e[l][0] + n * e[l][1] - x * z->w[0] - y * z->w[1];
            for (int c = 0; c <= r; c++)
                own->P[r][c] += x * z->K[c][0] + y * z->K[c][1] - k * PH[c][0] - n * PH[c][1];
            for (int c = 0; c < r; c++) own->P[c][r] = own->P[r][c];
        }
    }
    if (!counted) return;
    /* A misfit would inflate the part of the means, and the levels would creep. */
    const double square = 0.5 * (z->e[0] * z->w[0] + z->e[1] * z->w[1]);
    const double fits = square > unlikely ? unlikely / square : 1.0;
    for (int l = 0; l < q->variances_count; l++)
        for (int n = 0; n <= l; n++) {
            double *sum = q->out->information + l * FO_UNKNOWNS + n;
            for (int a = 0; a < 2; a++)
                for (int b = 0; b < 2; b++)
                    *sum += fits * e[l][a] * z->V[a][b] * e[n][b] + 0.5 * VS[l][a][b] * VS[n][b][a];
        }
}

/* Derivatives of the innovation through the state. */
static void innovation_by_state(const update *z, const fo_filter *f, double by[2][FO_SENSITIVE])
{
    for (int a = 0; a < 2; a++) {
        double *e = by[a];
        for (int j = 0; j < FO_SENSITIVE; j++) e[j] -= f->by[FO_NOISE + a][j];
        for (int k = 0; k < FO_BY; k++) {
            const double h = z->H[a][k].d[0], *x = f->by[fo_measured_states[k]];
            for (int j = 0; j < FO_SENSITIVE; j++) e[j] -= h * x[j];
        }
    }
}

/* Derivatives of the innovation, of the state held. */
static void innovation_by(const fo_prediction *p, const update *z, double by[2][FO_SENSITIVE])
{
    memset(by, 0, 2 * sizeof *by);
    for (int a = 0; a < 2; a++) {
        double *e = by[a];
        for (int j = 0; j < FO_SLOPES; j++) e[MODEL + j] += z->by_model[a][j];
        for (int j = 0; j < FO_COLUMNS; j++) e[MEANS + j] -= p->measured_by[a][j];
        for (int j = 0; j < 2 * FO_ORDERS; j++)
            e[FO_L - FO_LEVELS + j] -= z->angle * (p->sensed[a][A] * p->angle_by[A][j] +
                                                   p->sensed[a][B] * p->angle_by[B][j]);
    }
}

/* Normalised square of an innovation. The filter considers the covariance C of its parameters, but does not learn them
 * (Schmidt): the covariance is not `own` but `own` + E C Eᵀ, with E = ∂e/∂p in `by`. */
static double considered_square(const double *C, double own[2][2], double by[2][FO_SENSITIVE], const update *z)
{
    double V[2][2] = {{own[0][0], own[0][1]}, {own[1][0], own[1][1]}};
    for (int r = 0; r < FO_SENSITIVE; r++) {
        const double *row = C + (r + FO_LEVELS) * FO_UNKNOWNS + FO_LEVELS;
        double sum[2] = {0.0, 0.0};
        for (int c = 0; c < FO_SENSITIVE; c++)
            for (int a = 0; a < 2; a++) sum[a] += row[c] * by[a][c];
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++) V[a][b] += by[a][r] * sum[b];
    }
    const double x = z->e[0], y = z->e[1], det = V[0][0] * V[1][1] - V[0][1] * V[1][0];
    return 0.5 * (V[1][1] * x * x - (V[0][1] + V[1][0]) * x * y + V[0][0] * y * y) / det;
}

/* A filter that makes its own course would follow an outlier. A normalised square of which 300 of a million rows
 * have a larger one is doubted, as that of Student's distribution with four degrees of freedom; but no more than so
 * many rows that follow each other, or the filter would believe itself only. Assumed. */
static const double outlying = 8.0, freedom = 2.0;
enum { OUTLIERS = 3 };

static void doubt_outlier(fo_filter *f, update *z)
{
    const double square = 0.5 * (z->e[0] * z->w[0] + z->e[1] * z->w[1]);
    f->doubted = square > outlying ? f->doubted + 1 : 0;
    if (f->doubted == 0 || f->doubted > OUTLIERS) return;
    const double weight = (1.0 + freedom) / (square + freedom);
    for (int a = 0; a < 2; a++) {
        z->w[a] *= weight;
        for (int b = 0; b < 2; b++) z->V[a][b] *= weight;
    }
}

/* More such rows are those of a load step: then the filter no longer knows the acceleration, but not more often than
 * once in so many rows (manoeuvre detection). The step accelerates to the usual speed in 10 ms. Assumed. */
enum { CALM = 40 };
static const double quicker = 10.0;

static void expect_load_step(const pass *q, fo_filter *f)
{
    if (f->doubted <= OUTLIERS || f->row < f->calm) return;
    f->P[FO_ACCELERATION][FO_ACCELERATION] += q->load_step;
    f->calm = f->row + CALM;
}

/* Measurement update of state and covariance; `by`: derivatives of the innovation, if they are wanted; of the state
 * held unless its own are wanted too. */
static bool measure(const pass *q, const double measured[2], double rounding, const fo_prediction *p,
                    fo_filter *f, bool counted, update *z, double by[2][FO_SENSITIVE])
{
    const fo_model *m = q->m;
    double d[FO_BY], H[2][FO_BY], PH[S][2], own[2][2];
    deviation(q->course, f->x, d);
    z->angle = d[FO_BY_ANGLE];
    for (int a = 0; a < 2; a++) {
        fo_dual e = fo_shift(measured[a], fo_scale(-1.0, a ? p->measured.b : p->measured.a));
        for (int k = 0; k < FO_BY; k++) {
            H[a][k] = z->H[a][k].d[0];
            fo_accumulate_scaled(&e, -d[k], &z->H[a][k]);
        }
        z->e[a] = e.d[0] - f->x[FO_NOISE + a];
        for (int k = 0; q->of_course && k < FO_BY; k++) fo_accumulate_scaled(&e, d[k], &z->H[a][k]);
        for (int j = 0; j < FO_SLOPES; j++) z->by_model[a][j] = e.d[1 + j];
    }
    if (q->of_course) z->angle = 0.0;
    times_slope(f->P, H, PH);
    for (int a = 0; a < 2; a++)
        for (int b = a; b < 2; b++) {
            z->noise[a][b] = z->noise[b][a] = q->course->doubt * m->noise * noise_of(p, a, b);
            z->R[a][b] = z->R[b][a] = z->noise[a][b] + (a == b ? rounding : 0.0);
            own[a][b] = own[b][a] = z->R[a][b] + slope_times(H, a, PH, b);
        }
    z->det = own[0][0] * own[1][1] - own[0][1] * own[0][1];
    if (!(z->det > 0.0) || !isfinite(z->det) || !isfinite(z->e[0])) return false;
    z->V[0][0] = own[1][1] / z->det;
    z->V[0][1] = z->V[1][0] = -own[0][1] / z->det;
    z->V[1][1] = own[0][0] / z->det;
    for (int a = 0; a < 2; a++) z->w[a] = z->V[a][0] * z->e[0] + z->V[a][1] * z->e[1];
    if (q->sensitive || q->direct) innovation_by(p, z, by);
    if (q->sensitive) innovation_by_state(z, f, by);
    if (q->follower) {
        f->square = considered_square(q->follower->covariance, own, by, z);
        doubt_outlier(f, z);
    }
    for (int r = 0; r < S; r++) {
        for (int a = 0; a < 2; a++) z->K[r][a] = PH[r][0] * z->V[0][a] + PH[r][1] * z->V[1][a];
        f->x[r] += PH[r][0] * z->w[0] + PH[r][1] * z->w[1];
    }
    for (int r = 0; r < S; r++) {
        for (int c = 0; c <= r; c++) f->P[r][c] -= z->K[r][0] * PH[c][0] + z->K[r][1] * PH[c][1];
        for (int c = 0; c < r; c++) f->P[c][r] = f->P[r][c];
    }
    if (q->variances) measure_variances(q, H, z, counted);
    return true;
}

/* Measurement update of the derivatives of the state. */
static void measure_sensitivity(const update *z, fo_filter *f, double by[2][FO_SENSITIVE])
{
    for (int r = 0; r < S; r++) {
        const double k = z->K[r][0], n = z->K[r][1];
        for (int j = 0; j < FO_SENSITIVE; j++) f->by[r][j] += k * by[0][j] + n * by[1][j];
    }
}

/* Adds a row to the objective and to the information. */
static void count(const update *z, double by[2][FO_SENSITIVE], bool sensitive, fo_likelihood *out)
{
    const double square = z->e[0] * z->w[0] + z->e[1] * z->w[1];
    out->objective += 0.5 * (square + log(z->det));
    out->mean_square += 0.5 * square;
    out->counted++;
    if (!sensitive) return;
    for (int r = MODEL; r < FO_SENSITIVE; r++) {
        const double a = z->V[0][0] * by[0][r] + z->V[0][1] * by[1][r];
        const double b = z->V[1][0] * by[0][r] + z->V[1][1] * by[1][r];
        double *row = out->information + (r + FO_LEVELS) * FO_UNKNOWNS + FO_LEVELS;
        for (int c = MODEL; c <= r; c++) row[c] += a * by[0][c] + b * by[1][c];
    }
}

/* Transition to the next row. */
typedef struct {
    fo_dual bent[FO_BENT];
    double F[FO_ELEMENTS];
} transition;

/* P ← F P Fᵀ */
static void move_covariance(const fo_elements *elements, const double F[FO_ELEMENTS], double P[S][S])
{
    double half[S][S];
    fo_on_both_sides(elements, F, false, P, half);
}

/* An interval: its voltage, the derivative of this by the lag, and both rows of the course. */
typedef struct {
    double h, now[2], late[2];
    double place; /* of the interval in the log, from 0 to 1 */
    const fo_course *from, *to;
    const fo_prediction *at, *next;
    size_t periods;
} interval;

/* The electrical part of an interval. Flux and current change within it. With X = h R ∂i/∂λ the current
 * at its end counts W = ½ + Xᵀ/12 in its mean (the series of 1/(1 − e^{−x}) − 1/x). A leg of the
 * inverter switches twice, around the middle, so its loss is that of the middle current: Y = h V S'
 * ∂i/∂λ counts half at each end. λ⁺ = λ̄⁺ + M r with M = (1 + X/2 + X²/12 + Y/2)⁻¹: the flux decays by the
 * Padé approximation of e^{−X}. */
typedef struct {
    fo_dual W[2][2];
    fo_dual R;             /* now [Ω] */
    fo_dual slope[2][2];   /* h (R + V S') */
    fo_dual half[2][2];    /* X/2 − X²/12 + Y/2 */
    fo_dual M[2][2];
    fo_pair mean, middle;  /* currents of the course */
    double swing[2];       /* second difference of the current if the voltage turns with the rotor */
    fo_signs sign;         /* of the middle one */
} electrical;

/* Mean and middle of the course's current: its ends, weighted, less a twelfth and an eighth of its second
 * difference, by which ∂i/∂θ and ∂i/∂λ turn with the rotor; and, as far as the voltage turns within the row, the
 * flux bends. */
static void currents_of(const fo_model *m, const interval *t, electrical *e)
{
    const fo_dual step[2] = {fo_sub(t->next->terminal.a, t->at->terminal.a),
                             fo_sub(t->next->terminal.b, t->at->terminal.b)};
    const double turn = t->to->angle - t->from->angle;
    const double change[2] = {t->to->flux[A] - t->from->flux[A], t->to->flux[B] - t->from->flux[B]};
    const double swing[2] = {-turn * t->h * t->now[B], turn * t->h * t->now[A]};
    fo_dual mean[2], middle[2];
    for (int a = 0; a < 2; a++) {
        mean[a] = a ? t->at->terminal.b : t->at->terminal.a;
        middle[a] = fo_axpy(mean[a], 0.5, step[a]);
        for (int b = 0; b < 2; b++) fo_accumulate(&mean[a], &e->W[a][b], &step[b]);
        const fo_dual *from = t->at->slope[a], *to = t->next->slope[a];
        fo_dual bend = fo_scale(turn, fo_sub(to[FO_BY_ANGLE], from[FO_BY_ANGLE]));
        for (int b = 0; b < 2; b++) bend = fo_axpy(bend, change[b], fo_sub(to[b], from[b]));
        for (int b = 0; b < 2; b++) fo_accumulate_scaled(&bend, m->rotation * swing[b], &from[b]);
        e->swing[a] = swing[A] * from[A].d[0] + swing[B] * from[B].d[0];
        fo_accumulate_scaled(&mean[a], -1.0 / 12.0, &bend);
        fo_accumulate_scaled(&middle[a], -1.0 / 8.0, &bend);
    }
    e->mean = (fo_pair){mean[A], mean[B]};
    e->middle = (fo_pair){middle[A], middle[B]};
}

static void matrix_product(fo_dual x[2][2], fo_dual y[2][2], fo_dual out[2][2])
{
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            fo_product(&out[a][b], &x[a][0], &y[0][b]);
            fo_accumulate(&out[a][b], &x[a][1], &y[1][b]);
        }
}

static electrical electrical_of(const fo_model *m, const interval *t)
{
    electrical e;
    const fo_pair *from = &t->at->terminal, *to = &t->next->terminal;
    const double along[2] = {to->a.d[0] - from->a.d[0], to->b.d[0] - from->b.d[0]};
    const double about[2] = {from->a.d[0] + 0.5 * along[A], from->b.d[0] + 0.5 * along[B]};
    const fo_signs rough = fo_signs_of(m, about, along, t->periods);
    e.R = fo_scale(1.0 + m->heat * t->place, m->R);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            e.slope[a][b] = fo_constant(t->h * m->loss * rough.by_current[a][b]);
            if (a == b) e.slope[a][b] = fo_axpy(e.slope[a][b], t->h, e.R);
        }
    const fo_dual hR = fo_scale(t->h, e.R);
    fo_dual by_flux[2][2], X[2][2], both[2][2], square[2][2], whole[2][2];
    for (int a = 0; a < 2; a++) memcpy(by_flux[a], t->at->slope[a], sizeof by_flux[a]);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) X[a][b] = fo_mul(hR, by_flux[a][b]);
    matrix_product(e.slope, by_flux, both);
    matrix_product(X, X, square);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            e.W[a][b] = fo_shift(a == b ? 0.5 : 0.0, fo_scale(1.0 / 12.0, X[b][a]));
            e.half[a][b] = fo_axpy(fo_scale(0.5, both[a][b]), -1.0 / 12.0, square[a][b]);
            whole[a][b] = fo_axpy(fo_scale(0.5, both[a][b]), 1.0 / 12.0, square[a][b]);
            if (a == b) whole[a][b].d[0] += 1.0;
        }
    const fo_dual inverse =
        fo_inverse(fo_msub(fo_mul(whole[0][0], whole[1][1]), whole[0][1], whole[1][0]));
    fo_product(&e.M[0][0], &whole[1][1], &inverse);
    fo_product(&e.M[1][1], &whole[0][0], &inverse);
    e.M[0][1] = fo_scale(-1.0, fo_mul(whole[0][1], inverse));
    e.M[1][0] = fo_scale(-1.0, fo_mul(whole[1][0], inverse));
    currents_of(m, t, &e);
    const double middle[2] = {e.middle.a.d[0], e.middle.b.d[0]};
    e.sign = fo_signs_of(m, middle, along, t->periods);
    return e;
}

/* A cage in an interval of the course: its flux follows ψ' = R_R (i_d − ψ/L_M), and turns faster than
 * the rotor by the slip R_R i_q/ψ. */
typedef struct {
    double psi, rate;       /* [Wb]; R_R h [Ω s] */
    fo_dual i_d, i_q;       /* mean currents */
    double by[2][FO_COLUMNS];  /* of i_d and i_q, by the parameters of the means */
} cage;

static const double least_psi = 1e-9; /* [Wb]: the slip is finite */

static cage cage_of(const fo_model *m, const interval *t)
{
    cage g;
    const fo_prediction *ends[2] = {t->at, t->next};
    const double angles[2] = {t->from->angle, t->to->angle};
    const double psi = m->psi.d[0] + 0.5 * (t->from->psi + t->to->psi);
    memset(&g, 0, sizeof g);
    g.psi = psi > least_psi ? psi : least_psi;
    g.rate = m->R_R * t->h;
    for (int n = 0; n < 2; n++) {
        const double c = 0.5 * cos(angles[n]), s = 0.5 * sin(angles[n]);
        const fo_prediction *p = ends[n];
        g.i_d = fo_add(g.i_d, fo_axpy(fo_scale(c, p->current.a), s, p->current.b));
        g.i_q = fo_add(g.i_q, fo_axpy(fo_scale(c, p->current.b), -s, p->current.a));
        for (int j = 0; j < FO_COLUMNS; j++) {
            g.by[0][j] += c * p->by[A][j] + s * p->by[B][j];
            g.by[1][j] += c * p->by[B][j] - s * p->by[A][j];
        }
    }
    /* If the voltage is constant in stator coordinates, the current bends in rotor coordinates: with Δλ = h λ̇,
     * h² i'' = (−2 j h ω e^{−jθ} Δλ − (h ω)² e^{−jθ} λ)/L_σ; a twelfth of it is missing. As far as it turns within
     * the row, j h² ω e^{−jθ} u/L_σ is added. */
    const double turn = t->to->angle - t->from->angle, middle = 0.5 * (angles[0] + angles[1]);
    const double c = cos(middle), s = sin(middle), share = 1.0 / (12.0 * m->scale[0].d[0]);
    const double *x = t->from->flux, *y = t->to->flux;
    const double step[2] = {c * (y[A] - x[A]) + s * (y[B] - x[B]),
                            c * (y[B] - x[B]) - s * (y[A] - x[A])};
    const double mean[2] = {0.5 * (c * (x[A] + y[A]) + s * (x[B] + y[B])),
                            0.5 * (c * (x[B] + y[B]) - s * (x[A] + y[A]))};
    const double u[2] = {t->h * (c * t->now[A] + s * t->now[B]), t->h * (c * t->now[B] - s * t->now[A])};
    g.i_d.d[0] -= share * turn * (2.0 * step[1] - turn * mean[0] - m->rotation * u[1]);
    g.i_q.d[0] -= share * turn * (-2.0 * step[0] - turn * mean[1] + m->rotation * u[0]);
    g.by[0][FO_L_rotation - FO_FIRST_OF_MEANS] += share * turn * u[1];
    g.by[1][FO_L_rotation - FO_FIRST_OF_MEANS] -= share * turn * u[0];
    const int iron = FO_L_iron_loss - FO_FIRST_OF_MEANS; /* its current does not reach the rotor */
    g.by[0][iron] = g.by[1][iron] = 0.0;
    return g;
}

/* Flux after the interval, and its rows of the transition. `d`: the state's distance from the course
 * before it. */
static void move_flux(const fo_model *m, const interval *t, const electrical *e, const cage *g,
                      const double d[FO_BY], const double x[S], fo_dual moved[2], transition *F)
{
    const double h = t->h;
    const fo_prediction *p = t->at;
    const double u[2] = {t->now[A] + m->lag * t->late[A], t->now[B] + m->lag * t->late[B]};
    /* How much more the angle turns than the course. */
    fo_dual step = fo_constant(t->from->angle - t->to->angle + h * x[FO_SPEED]);
    if (m->machine.cage) step = fo_axpy(step, g->rate / g->psi, g->i_q);
    fo_dual r[2], by_angle[2], by_psi[2], by_step[2], late[2];
    const fo_dual *alpha = p->slope[A], *beta = p->slope[B];
    for (int a = 0; a < 2; a++) {
        fo_product(&late[a], &e->W[a][A], &alpha[FO_BY_ANGLE]);
        fo_accumulate(&late[a], &e->W[a][B], &beta[FO_BY_ANGLE]);
    }
    for (int a = 0; a < 2; a++) {
        const fo_dual i = a ? e->mean.b : e->mean.a;
        r[a] = fo_scale(-h, fo_mul(e->R, i));
        r[a].d[0] += h * u[a] - t->to->flux[a] + x[FO_FLUX + a] - h * x[FO_DRIFT + a];
        r[a].d[0] -= h * m->loss * e->sign.value[a];
        for (int k = 1; k < FO_WIDTH; k++)
            r[a].d[k] -= h * m->loss * (e->sign.by_current[a][A] * e->middle.a.d[k] +
                                        e->sign.by_current[a][B] * e->middle.b.d[k]);
        fo_product(&by_angle[a], &e->slope[a][A], &alpha[FO_BY_ANGLE]);
        fo_accumulate(&by_angle[a], &e->slope[a][B], &beta[FO_BY_ANGLE]);
        fo_product(&by_psi[a], &e->slope[a][A], &alpha[FO_BY_PSI]);
        fo_accumulate(&by_psi[a], &e->slope[a][B], &beta[FO_BY_PSI]);
        fo_product(&by_step[a], &e->slope[a][A], &late[A]);
        fo_accumulate(&by_step[a], &e->slope[a][B], &late[B]);
        fo_accumulate_scaled(&r[a], -d[FO_BY_ANGLE], &by_angle[a]);
        fo_accumulate_scaled(&r[a], -d[FO_BY_PSI], &by_psi[a]);
        fo_reduce(&r[a], &by_step[a], &step);
        for (int b = 0; b < 2; b++) fo_accumulate_scaled(&r[a], -d[b], &e->half[a][b]);
    }
    for (int a = 0; a < 2; a++) {
        const fo_dual *M = e->M[a];
        fo_dual *own = F->bent + OF_FLUX + FLUX_WIDTH * a;
        for (int b = 0; b < 2; b++) {
            own[b] = M[b];
            fo_reduce(&own[b], &M[A], &e->half[A][b]);
            fo_reduce(&own[b], &M[B], &e->half[B][b]);
        }
        own[2] = fo_scale(-1.0, fo_mac(fo_mul(M[A], by_angle[A]), M[B], by_angle[B]));
        own[3] = fo_scale(-h, fo_mac(fo_mul(M[A], by_step[A]), M[B], by_step[B]));
        own[4] = fo_scale(-1.0, fo_mac(fo_mul(M[A], by_psi[A]), M[B], by_psi[B]));
        own[5] = fo_scale(-h, M[A]);
        own[6] = fo_scale(-h, M[B]);
        moved[a] = fo_shift(t->to->flux[a], fo_mul(M[A], r[A]));
        fo_accumulate(&moved[a], &M[B], &r[B]);
    }
}

/* Derivatives of a current in rotor coordinates. */
static void rotor_derivatives(const fo_prediction *p, double angle, fo_dual d[FO_BY], fo_dual q[FO_BY])
{
    const double c = cos(angle), s = sin(angle);
    for (int k = 0; k < FO_BY; k++) {
        d[k] = fo_axpy(fo_scale(c, p->slope[A][k]), s, p->slope[B][k]);
        q[k] = fo_axpy(fo_scale(c, p->slope[B][k]), -s, p->slope[A][k]);
    }
    const fo_dual i_d = fo_axpy(fo_scale(c, p->current.a), s, p->current.b);
    const fo_dual i_q = fo_axpy(fo_scale(c, p->current.b), -s, p->current.a);
    d[FO_BY_ANGLE] = fo_add(d[FO_BY_ANGLE], i_q);
    q[FO_BY_ANGLE] = fo_sub(q[FO_BY_ANGLE], i_d);
}

/* Angle, speed and ψ after the interval, with their rows of the transition: the torque is 3/2 n_p times
 * flux × current. */
static void move_rotor(const fo_model *m, const interval *t, const cage *g, const double d[FO_BY],
                       const double x[S], fo_dual *angle, fo_dual *speed, fo_dual *psi, transition *F)
{
    const double h = t->h, *course = t->from->flux;
    const fo_prediction *p = t->at;
    const fo_dual torque = fo_axpy(fo_scale(course[A], p->current.b), -course[B], p->current.a);
    const fo_dual mobility = fo_scale(h, m->mobility);
    fo_dual *by = F->bent + OF_SPEED;
    for (int k = 0; k < FO_BY; k++) {
        by[k] = fo_axpy(fo_scale(course[A], p->slope[B][k]), -course[B], p->slope[A][k]);
        if (k == FO_BY_ALPHA) by[k] = fo_add(by[k], p->current.b);
        if (k == FO_BY_BETA) by[k] = fo_sub(by[k], p->current.a);
        by[k] = fo_mul(mobility, by[k]);
    }
    *speed = fo_shift(h * x[FO_ACCELERATION], fo_mul(mobility, torque));
    *angle = fo_shift(x[FO_ANGLE] + h * x[FO_SPEED], fo_scale(0.5 * h, *speed));
    for (int k = 0; k < FO_BY; k++) fo_accumulate_scaled(speed, d[k], &by[k]);
    *speed = fo_shift(x[FO_SPEED], *speed);
    *psi = fo_constant(x[FO_PSI]);
    F->bent[OWN_ANGLE] = F->bent[OWN_PSI] = fo_constant(1.0);
    fo_dual *own = F->bent + OF_CAGE;
    memset(own, 0, (OF_TIME - OF_CAGE) * sizeof *own);
    if (!m->machine.cage) return;
    fo_dual i_d[FO_BY], i_q[FO_BY];
    const double over = g->rate / g->psi, decay = g->rate * m->over_L_M;
    rotor_derivatives(p, t->from->angle, i_d, i_q);
    i_q[FO_BY_PSI].d[0] -= g->i_q.d[0] / g->psi;
    fo_accumulate_scaled(angle, over, &g->i_q);
    *psi = fo_shift(-decay * g->psi + t->from->psi, fo_scale(g->rate, g->i_d));
    for (int k = 0; k < FO_BY; k++) {
        i_q[k] = fo_scale(over, i_q[k]);
        i_d[k] = fo_scale(g->rate, i_d[k]);
        fo_accumulate_scaled(angle, d[k], &i_q[k]);
        if (k == FO_BY_PSI) i_d[k].d[0] += 1.0 - decay;
        fo_accumulate_scaled(psi, d[k], &i_d[k]);
    }
    i_q[FO_BY_ANGLE].d[0] += 1.0;
    F->bent[OWN_ANGLE] = i_q[FO_BY_ANGLE];
    F->bent[OWN_PSI] = i_d[FO_BY_PSI];
    own[0] = i_q[FO_BY_ALPHA];
    own[1] = i_q[FO_BY_BETA];
    own[2] = i_q[FO_BY_PSI];
    own[3] = i_d[FO_BY_ALPHA];
    own[4] = i_d[FO_BY_BETA];
    own[5] = i_d[FO_BY_ANGLE];
}

/* Elements that do not depend on the parameters of the model, but those of coloured noise. */
static void put_values(const fo_model *m, double h, const update *z, transition *F)
{
    for (int k = 0; k < FO_BENT; k++) F->F[k] = F->bent[k].d[0];
    const double time[] = {h, 0.5 * h * h, 1.0, h, 1.0, 1.0, 1.0};
    memcpy(F->F + OF_TIME, time, sizeof time);
    memset(F->F + OF_NOISE, 0, 2 * NOISE_WIDTH * sizeof *F->F);
    if (!m->is_coloured) return;
    for (int a = 0; a < 2; a++) {
        double *own = F->F + OF_NOISE + NOISE_WIDTH * a;
        own[0] = m->pole - (z ? m->colour : 0.0);
        for (int k = 0; k < FO_BY; k++) own[1 + k] = z ? -m->colour * z->H[a][k].d[0] : 0.0;
    }
}

/* What the parameters of the means change in an interval. */
static void move_means(const fo_model *m, const interval *t, const electrical *e, const cage *g,
                       const update *z, double next[S][FO_SENSITIVE])
{
    const double h = t->h, turning = h * m->mobility.d[0], *course = t->from->flux;
    const fo_prediction *p = t->at;
    double r[2][FO_COLUMNS];
    for (int j = 0; j < FO_COLUMNS; j++) {
        double i[2];
        for (int a = 0; a < 2; a++) {
            i[a] = p->by[a][j];
            for (int b = 0; b < 2; b++)
                i[a] += e->W[a][b].d[0] * (t->next->by[b][j] - p->by[b][j]);
        }
        for (int a = 0; a < 2; a++) {
            r[a][j] = -h * (e->R.d[0] * i[a] + m->loss * (e->sign.by_current[a][A] * i[A] +
                                                          e->sign.by_current[a][B] * i[B]));
            if (z) next[FO_NOISE + a][MEANS + j] -= m->colour * p->measured_by[a][j];
        }
        if (j == FO_L_iron_loss - FO_FIRST_OF_MEANS) continue; /* its current makes no torque */
        const double more = turning * (course[A] * p->by[B][j] - course[B] * p->by[A][j]);
        next[FO_SPEED][MEANS + j] += more;
        next[FO_ANGLE][MEANS + j] += 0.5 * h * more;
    }
    if (m->machine.cage) {
        const double decay = g->rate * m->over_L_M * g->psi;
        for (int j = 0; j < FO_COLUMNS; j++) {
            next[FO_PSI][MEANS + j] += g->rate * g->by[0][j];
            next[FO_ANGLE][MEANS + j] += g->rate / g->psi * g->by[1][j];
        }
        next[FO_PSI][FO_L_rotor_resistance - FO_LEVELS] += g->rate * g->i_d.d[0] - decay;
        next[FO_ANGLE][FO_L_rotor_resistance - FO_LEVELS] += g->rate / g->psi * g->i_q.d[0];
        next[FO_PSI][FO_L_magnetizing - FO_LEVELS] += decay;
    }
    for (int a = 0; a < 2; a++) {
        double *own = r[a];
        own[FO_L_heat - FO_FIRST_OF_MEANS] -=
            h * t->place * m->R.d[0] * (a ? e->mean.b : e->mean.a).d[0];
        own[FO_L_loss - FO_FIRST_OF_MEANS] -= h * m->loss * e->sign.value[a];
        own[FO_L_rotation - FO_FIRST_OF_MEANS] +=
            h * (e->R.d[0] * e->swing[a] / 12.0 +
                 m->loss / 8.0 * (e->sign.by_current[a][A] * e->swing[A] + e->sign.by_current[a][B] * e->swing[B]));
        own[FO_L_knee - FO_FIRST_OF_MEANS] -= h * m->loss * e->sign.by_knee[a];
        own[FO_L_lag - FO_FIRST_OF_MEANS] += h * t->late[a];
        own[FO_L_delay - FO_FIRST_OF_MEANS] += h * t->late[a];
    }
    for (int a = 0; a < 2; a++) {
        const double x = e->M[a][A].d[0], y = e->M[a][B].d[0];
        for (int j = 0; j < FO_COLUMNS; j++)
            next[FO_FLUX + a][MEANS + j] += x * r[A][j] + y * r[B][j];
    }
}

static void add_of_model(double row[FO_SENSITIVE], const fo_dual *from)
{
    for (int j = 0; j < FO_SLOPES; j++) row[MODEL + j] += from->d[1 + j];
}

/* The process noise of an interval. By a level, its own part counts twice, since it is the logarithm of
 * a standard deviation. */
static void add_noise(const pass *q, double h, bool measured, fo_filter *f)
{
    const fo_model *m = q->m;
    const double passed = fabs(h);
    const double calm = passed * q->course->unrest * m->acceleration;
    f->P[FO_PSI][FO_PSI] += passed * m->machine.psi_rate * m->machine.psi_rate;
    f->P[FO_ACCELERATION][FO_ACCELERATION] += calm;
    for (int a = 0; a < 2; a++) {
        f->P[FO_FLUX + a][FO_FLUX + a] += passed * m->voltage;
        f->P[FO_DRIFT + a][FO_DRIFT + a] += passed * m->drift;
    }
    /* Where the current is missing, its noise is unknown. */
    const double more = measured ? 0.0 : m->colour * m->colour * m->noise;
    for (int r = FO_NOISE; r < S; r++) f->P[r][r] += more;
    if (!q->variances) return;
    q->variances[FO_L_acceleration].P[FO_ACCELERATION][FO_ACCELERATION] += 2.0 * calm;
    for (int a = 0; a < 2; a++) {
        q->variances[FO_L_voltage].P[FO_FLUX + a][FO_FLUX + a] += 2.0 * passed * m->voltage;
        q->variances[FO_L_drift].P[FO_DRIFT + a][FO_DRIFT + a] += 2.0 * passed * m->drift;
        q->variances[FO_L_noise].P[FO_NOISE + a][FO_NOISE + a] += 2.0 * more;
        if (!measured)
            q->variances[FO_L_colour_gain].P[FO_NOISE + a][FO_NOISE + a] +=
                2.0 * m->colour * m->noise;
    }
}

/* Time update of the derivatives by levels and colour. The colour also changes the transition of the
 * noise, z⁺ = ρ z + γ w. */
static void move_variances(const pass *q, const update *z, const double residual[2],
                           const double F[FO_ELEMENTS], fo_filter *f)
{
    double slope[2][2][S] = {{{0.0}}}, moved[2][2][S]; /* rows of ∂F; ∂F P Fᵀ */
    for (int l = 0; l < q->variances_count; l++) {
        by_variance *own = q->variances + l;
        double next[S];
        fo_times(&q->elements, F, false, 1, own->x, next);
        memcpy(own->x, next, sizeof next);
        move_covariance(&q->elements, F, own->P);
    }
    if (!q->m->is_coloured) return;
    for (int a = 0; a < 2; a++) {
        slope[0][a][FO_NOISE + a] = 1.0;
        if (!z) continue;
        slope[1][a][FO_NOISE + a] = -1.0;
        for (int k = 0; k < FO_BY; k++) slope[1][a][fo_measured_states[k]] = -z->H[a][k].d[0];
    }
    for (int n = 0; n < 2; n++)
        for (int a = 0; a < 2; a++) {
            double P[S] = {0.0};
            for (int r = 0; r < S; r++)
                for (int c = 0; c < S; c++) P[c] += slope[n][a][r] * f->P[r][c];
            fo_times(&q->elements, F, false, 1, P, moved[n][a]);
        }
    for (int n = 0; n < 2; n++) {
        by_variance *own = q->variances + FO_LEVELS + n;
        for (int a = 0; a < 2; a++) {
            own->x[FO_NOISE + a] += n ? residual[a] : f->x[FO_NOISE + a];
            for (int r = 0; r < S; r++) {
                own->P[FO_NOISE + a][r] += moved[n][a][r];
                own->P[r][FO_NOISE + a] += moved[n][a][r];
            }
        }
    }
}

/* Takes the derivatives of the transition, times the state's distance from the course, from those of the states. */
static void leave_course(const pass *q, const interval *t, const fo_filter *f, const transition *F,
                         double next[S][FO_SENSITIVE])
{
    double d[S] = {0.0};
    for (int a = 0; a < 2; a++) {
        d[FO_FLUX + a] = f->x[FO_FLUX + a] - t->from->flux[a];
        d[FO_DRIFT + a] = f->x[FO_DRIFT + a];
    }
    d[FO_ANGLE] = f->x[FO_ANGLE] - t->from->angle;
    d[FO_SPEED] = f->x[FO_SPEED] - (t->to->angle - t->from->angle) / t->h;
    d[FO_PSI] = f->x[FO_PSI] - t->from->psi;
    for (int n = 0; n < q->elements.count && q->elements.at[n] < FO_BENT; n++) {
        const int k = q->elements.at[n], r = fo_pattern[k][0];
        for (int j = 0; j < FO_SLOPES; j++) next[r][MODEL + j] -= d[fo_pattern[k][1]] * F->bent[k].d[1 + j];
    }
}

/* States after an interval. */
typedef struct {
    fo_dual flux[2], angle, speed, psi;
} moved_states;

/* Adds the derivatives of the states after an interval, of those before it held. */
static void moved_by(const pass *q, const interval *t, const update *z, const double residual[2],
                     const electrical *e, const cage *g, const fo_filter *f, const moved_states *to,
                     const transition *F, double next[S][FO_SENSITIVE])
{
    const fo_model *m = q->m;
    double d[FO_BY];
    deviation(t->from, f->x, d);
    move_means(m, t, e, g, z, next);
    add_of_model(next[FO_FLUX], &to->flux[A]);
    add_of_model(next[FO_FLUX + 1], &to->flux[B]);
    add_of_model(next[FO_ANGLE], &to->angle);
    add_of_model(next[FO_SPEED], &to->speed);
    add_of_model(next[FO_PSI], &to->psi);
    for (int a = 0; a < 2 && m->is_coloured; a++) {
        double *own = next[FO_NOISE + a];
        own[POLE] += f->x[FO_NOISE + a];
        if (!z) continue;
        own[GAIN] += residual[a];
        fo_dual i = a ? t->at->measured.b : t->at->measured.a;
        for (int k = 0; !q->of_course && k < FO_BY; k++) fo_accumulate_scaled(&i, d[k], &z->H[a][k]);
        i = fo_scale(-m->colour, i);
        add_of_model(own, &i);
    }
    if (q->of_course) leave_course(q, t, f, F, next);
}

/* Time update over an interval; `z`: the measurement before it, or null. `residual`: what it left. `row`: keeps the
 * derivatives of this step, if they are wanted. */
static void advance(const pass *q, const interval *t, const update *z, const double residual[2],
                    fo_filter *f, transition *F, fo_row *row)
{
    const fo_model *m = q->m;
    const electrical e = electrical_of(m, t);
    double d[FO_BY];
    moved_states to;
    cage g;
    deviation(t->from, f->x, d);
    if (m->machine.cage) g = cage_of(m, t);
    move_flux(m, t, &e, &g, d, f->x, to.flux, F);
    move_rotor(m, t, &g, d, f->x, &to.angle, &to.speed, &to.psi, F);
    put_values(m, t->h, z, F);
    if (q->sensitive) {
        double next[S][FO_SENSITIVE];
        fo_times(&q->elements, F->F, false, FO_SENSITIVE, f->by[0], next[0]);
        moved_by(q, t, z, residual, &e, &g, f, &to, F, next);
        memcpy(f->by, next, sizeof next);
    } else if (q->direct) {
        memset(row->moved_by, 0, sizeof row->moved_by);
        moved_by(q, t, z, residual, &e, &g, f, &to, F, row->moved_by);
    }
    if (q->variances) move_variances(q, z, residual, F->F, f);
    move_covariance(&q->elements, F->F, f->P);
    for (int a = 0; a < 2; a++) {
        f->x[FO_FLUX + a] = to.flux[a].d[0];
        f->x[FO_NOISE + a] = m->pole * f->x[FO_NOISE + a] + (z ? m->colour * residual[a] : 0.0);
    }
    f->x[FO_ANGLE] = to.angle.d[0];
    f->x[FO_SPEED] = to.speed.d[0];
    f->x[FO_PSI] = to.psi.d[0];
    add_noise(q, t->h, z, f);
}

/* Keeps what the filter knows after the measurement update of a row. */
static void keep_row(const pass *q, const fo_filter *f, const fo_prediction *at, const update *z,
                     double error_by[2][FO_SENSITIVE], fo_row *row)
{
    memcpy(row->own, f->x, sizeof row->own);
    for (int a = 0; a < 2; a++) {
        row->current[a] = a ? at->current.b.d[0] : at->current.a.d[0];
        for (int k = 0; k < FO_BY; k++) row->slope[a][k] = at->slope[a][k].d[0];
    }
    memcpy(row->P, f->P, sizeof row->P);
    row->measured = z;
    if (z && (q->direct || q->sensitive)) memcpy(row->error_by, error_by, sizeof row->error_by);
    if (q->sensitive) {
        memcpy(row->own_by, f->by, sizeof row->own_by);
        for (int a = 0; a < 2; a++) {
            double *by = row->current_by[a];
            memset(by, 0, sizeof row->current_by[a]);
            add_of_model(by, a ? &at->current.b : &at->current.a);
            memcpy(by + MEANS, at->by[a], sizeof at->by[a]);
            by[FO_L_iron_loss - FO_LEVELS] = 0.0;
        }
    }
    if (!z) return;
    memcpy(row->error, z->e, sizeof row->error);
    memcpy(row->V, z->V, sizeof row->V);
    memcpy(row->noise, z->noise, sizeof row->noise);
    memcpy(row->K, z->K, sizeof row->K);
    for (int a = 0; a < 2; a++)
        for (int k = 0; k < FO_BY; k++) {
            row->H[a][k] = z->H[a][k].d[0];
            for (int j = 0; j < FO_SLOPES; j++) row->H_by[a][k][j] = z->H[a][k].d[1 + j];
        }
}

static void keep_transition(const transition *F, fo_row *row)
{
    memcpy(row->F, F->F, sizeof row->F);
    for (int k = 0; k < FO_BENT; k++)
        for (int j = 0; j < FO_SLOPES; j++) row->F_by[k][j] = F->bent[k].d[1 + j];
}

static fo_prediction prediction_at(const pass *q, const fo_filter *f)
{
    fo_prediction p;
    fo_predict(q->m, q->course, f->turning, f->rotor, &p);
    return p;
}

/* From 0 to 1. */
static double place_of(const fo_log *log, size_t k)
{
    return (double)(log->first + k) / (double)(log->whole ? log->whole : log->rows);
}

/* Angle by which a hint may contradict the filter, besides three of its standard deviations [rad]. Assumed. */
static const double contradicts = 0.3;
/* A filter that knows the angle better than this needs no hint [rad]. Assumed. */
static const double unsure = 0.1;

/* The course of the next row: rotor and flux go on turning. */
static void follow_filter(const pass *q, const fo_filter *f, double h)
{
    double turn = h * (f->x[FO_SPEED] + 0.5 * h * f->x[FO_ACCELERATION]);
    const double hint = q->follower->hints[f->row], std = sqrt(f->P[FO_ANGLE][FO_ANGLE]);
    if (isfinite(hint) && std > unsure) {
        const double error = remainder(hint - f->x[FO_ANGLE] - turn, FO_TURN);
        if (fabs(error) < contradicts + 3.0 * std) turn += error;
    }
    const double c = cos(turn), s = sin(turn);
    fo_course *next = q->followed + 1;
    next->angle = f->x[FO_ANGLE] + turn;
    next->flux[A] = c * f->x[FO_FLUX] - s * f->x[FO_FLUX + 1];
    next->flux[B] = s * f->x[FO_FLUX] + c * f->x[FO_FLUX + 1];
    next->psi = f->x[FO_PSI];
    next->unrest = next->doubt = 1.0;
}

/* A row and, unless it is the last, the interval to the next. `at` and `next`: predictions of both.
 * False: a number is not finite, or a covariance is not positive. */
static bool pass_row(const pass *q, const fo_prediction *at, fo_prediction *next, fo_filter *f,
                     fo_row *row)
{
    const fo_log *log = q->log;
    const size_t k = f->row;
    const double h = log->sample_time;
    const double *i = log->current + 2 * k, *u = log->voltage + 2 * k;
    const bool known = isfinite(u[0]) && isfinite(u[1]);
    const bool seen = isfinite(i[0]) && isfinite(i[1]);
    double before[2], residual[2] = {0.0, 0.0}, error_by[2][FO_SENSITIVE];
    memcpy(before, f->voltage, sizeof before);
    if (known) memcpy(f->voltage, u, sizeof f->voltage);
    if (k == 0) memcpy(before, f->voltage, sizeof before);
    const bool counted = q->out && k >= q->skipped;
    update z;
    if (seen) {
        measured_slope(at, z.H);
        const double rounding = log->rounding ? log->rounding[k] : 0.0;
        if (!measure(q, i, rounding, at, f, counted, &z, error_by)) return false;
        if (q->sensitive) measure_sensitivity(&z, f, error_by);
        if (counted) count(&z, error_by, q->sensitive, q->out);
        for (int a = 0; a < 2; a++) residual[a] = z.R[a][0] * z.w[0] + z.R[a][1] * z.w[1];
    }
    if (!isfinite(f->x[FO_ANGLE])) return false;
    if (row) keep_row(q, f, at, seen ? &z : NULL, error_by, row);
    f->row++;
    if (f->row == log->rows) return true;
    if (q->follower) expect_load_step(q, f);
    if (q->follower && f->row > q->follower->given) follow_filter(q, f, h);
    f->turning = (q->course[1].angle - q->course[0].angle) / h;
    memcpy(f->rotor, at->rotor, sizeof f->rotor);
    fo_predict(q->m, q->course + 1, f->turning, f->rotor, next);
    /* A late voltage mixes with that of the row before. An early one mixes with the next, which may answer
     * the noise of the current that it would predict, or is extrapolated. */
    const double *held = f->voltage, *after = u + 2;
    const bool mixes = log->early && q->m->lag < 0.0 && isfinite(after[0]) && isfinite(after[1]);
    const interval t = {h, {held[0], held[1]},
                        {mixes ? held[0] - after[0] : before[0] - held[0],
                         mixes ? held[1] - after[1] : before[1] - held[1]},
                        place_of(log, k), q->course, q->course + 1, at, next,
                        log->periods ? log->periods : 1};
    transition F;
    advance(q, &t, seen ? &z : NULL, residual, f, &F, row);
    f->unknown = known ? 0 : f->unknown + 1;
    if (!known) {
        const double *flux = q->course->flux, speed = f->turning;
        const double large = fmax(held[0] * held[0] + held[1] * held[1],
                                  speed * speed * (flux[0] * flux[0] + flux[1] * flux[1]));
        /* Each interval has the same error, so the std of their sum grows with their number. */
        const double more = 0.5 * h * h * large * (2.0 * (double)f->unknown - 1.0);
        for (int a = 0; a < 2; a++) f->P[a][a] += more;
    }
    if (row) keep_transition(&F, row);
    return true;
}

static void complete(fo_likelihood *out)
{
    if (out->counted) out->mean_square /= (double)out->counted;
    for (int r = 0; r < FO_UNKNOWNS; r++)
        for (int c = 0; c < r; c++)
            out->information[c * FO_UNKNOWNS + r] = out->information[r * FO_UNKNOWNS + c];
}

bool fo_innovations(const fo_problem *problem, const double parameters[FO_UNKNOWNS], fo_detail detail,
                    fo_likelihood *out, fo_filter *checkpoints)
{
    if (FO_SLOPES > 0 && detail == FO_OBJECTIVE)
        return fo_innovations_of_values(problem, parameters, detail, out, checkpoints);
    const fo_model m = fo_model_of(problem->machine, parameters);
    by_variance by[FO_VARIANCES];
    pass q = {.log = problem->log,
              .course = problem->course,
              .m = &m,
              .elements = fo_elements_of(&m),
              .sensitive = detail > FO_OBJECTIVE,
              .of_course = detail == FO_OF_COURSE,
              .skipped = problem->start->skipped,
              .out = out};
    fo_filter f;
    start_at(problem, &m, &f);
    memset(out, 0, sizeof *out);
    if (q.sensitive) {
        memset(by, 0, sizeof by);
        for (int r = FO_NOISE; r < S; r++) {
            by[FO_L_noise].P[r][r] = 2.0 * f.P[r][r];
            by[FO_L_colour_gain].P[r][r] = 2.0 * m.colour * m.noise;
        }
        q.variances = by;
        q.variances_count = m.is_coloured ? FO_VARIANCES : FO_LEVELS;
    }
    fo_prediction predictions[2];
    predictions[0] = prediction_at(&q, &f);
    for (size_t k = 0; k < problem->log->rows; k++, q.course++) {
        if (k % FO_CHUNK == 0) {
            if (fo_interrupted) return false;
            checkpoints[k / FO_CHUNK] = f;
        }
        if (!pass_row(&q, predictions + k % 2, predictions + (k + 1) % 2, &f, NULL)) return false;
    }
    complete(out);
    return true;
}

void fo_again(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
              const fo_filter *from, const fo_course *course, size_t count, fo_kept kept, fo_row *rows)
{
    if (FO_SLOPES > 0 && kept == FO_KEEP_VALUES) {
        fo_again_of_values(problem, parameters, from, course, count, kept, rows);
        return;
    }
    const fo_model m = fo_model_of(problem->machine, parameters);
    pass q = {.log = problem->log,
              .course = course,
              .m = &m,
              .elements = fo_elements_of(&m),
              .sensitive = kept == FO_KEEP_SENSITIVE,
              .direct = kept == FO_KEEP_DIRECT,
              .of_course = kept == FO_KEEP_SENSITIVE};
    fo_filter f = *from;
    fo_prediction predictions[2];
    predictions[0] = prediction_at(&q, &f);
    for (size_t k = 0; k < count; k++, q.course++)
        pass_row(&q, predictions + k % 2, predictions + (k + 1) % 2, &f, rows + k);
}

#ifndef FO_VALUES_ONLY
volatile int fo_interrupted = 0;

size_t fo_checkpoints(size_t rows)
{
    return (rows + FO_CHUNK - 1) / FO_CHUNK;
}

fo_log fo_rows_of(const fo_log *log, size_t first, size_t rows)
{
    fo_log out = *log;
    out.rows = rows;
    out.voltage += 2 * first;
    out.current += 2 * first;
    if (out.rounding) out.rounding += first;
    out.first = first;
    out.whole = log->rows;
    return out;
}

/* Page's cumulative sum of the normalised squares above `usual`: once it exceeds `misfit`, rows do not fit from where
 * it last was zero. Each square counts `largest` at most, so that a spike or a load step of eight rows is no misfit.
 * The first rows do not count; where a hint is a witness of the angle, the sum falls. Assumed. */
static const double usual = 3.0, misfit = 200.0, largest = 25.0;
/* Rows in which the filter's drift may hide what does not fit, and in which the filter settles. Assumed. */
enum { BEFORE = 40, SETTLING = 40 };
/* An angle that is known no better than this has no course [rad]: of a uniform angle, 1.81. Assumed. */
static const double lost = 1.2;
/* Intervals without a voltage, behind which the flux is lost. Assumed. */
enum { GAP = 10 };

static bool has_witness(const fo_follower *follower, size_t row, double angle)
{
    const double hint = follower->hints ? follower->hints[row] : (double)NAN;
    return isfinite(hint) && fabs(remainder(hint - angle, FO_TURN)) < contradicts;
}

size_t fo_follow(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_follower *follower)
{
    const fo_model m = fo_model_of(problem->machine, parameters);
    pass q = {.log = problem->log,
              .course = problem->course,
              .m = &m,
              .elements = fo_elements_of(&m),
              .sensitive = true,
              .follower = follower,
              .followed = problem->course,
              .load_step = pow(quicker * problem->start->acceleration_std, 2.0)};
    double sum = 0.0;
    size_t fitting = 0;
    fo_filter f;
    fo_prediction predictions[2];
    start_at(problem, &m, &f);
    const size_t apart = follower->given < SETTLING ? follower->given : SETTLING;
    if (apart) {
        const double turn = q.course[apart].angle - q.course[0].angle;
        f.x[FO_SPEED] = turn / ((double)apart * problem->log->sample_time);
    }
    predictions[0] = prediction_at(&q, &f);
    for (size_t k = 0; k < problem->log->rows; k++, q.course++, q.followed++) {
        f.square = 0.0;
        if (f.unknown > GAP) return k - f.unknown;
        if (fo_interrupted) return 0;
        if (!pass_row(&q, predictions + k % 2, predictions + (k + 1) % 2, &f, NULL)) return fitting;
        if (k >= SETTLING) {
            const bool counts = !has_witness(follower, k, q.course->angle);
            sum = fmax(sum + (counts ? fmin(f.square, largest) : 0.0) - usual, 0.0);
        }
        if (sum == 0.0) fitting = k + 1;
        if (sum > misfit) return fitting > BEFORE ? fitting - BEFORE : 0;
        if (k > follower->given && f.P[FO_ANGLE][FO_ANGLE] > lost * lost) return k;
    }
    return problem->log->rows;
}
#endif
