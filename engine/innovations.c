#include "innovations.h"

#include <math.h>
#include <string.h>

#include "dual.h"

enum { A, B }; /* components of a vector */

typedef struct {
    fo_dual R, inverse_d, inverse_q, psi, mobility, pole, colour;
    fo_dual noise, acceleration, voltage, drift; /* variances */
    double loss, inverse_knee, lag, iron, heat, offset[2], unequal[2];
    const double *harmonics; /* two coefficients of each order */
    bool is_coloured;
} model;

/* Derivatives of the states by the parameters that change the means only: the gain is the same. */
enum { COLUMNS = FO_UNKNOWNS - FO_C };
typedef double sensitivity[FO_STATES][COLUMNS];

typedef struct {
    fo_dual x[FO_STATES];
    fo_dual P[FO_STATES][FO_STATES];
    fo_pair residual; /* of the last measurement, after its update */
    bool measured;
    int states;
} state;

/* The current at a row of the course, and its derivatives. */
typedef struct {
    fo_pair current;  /* that makes flux */
    fo_pair terminal; /* with that of the iron loss */
    fo_pair measured; /* by the sensors */
    fo_dual by_flux[2][2];
    fo_dual by_angle[2];
    double by[2][COLUMNS]; /* by the parameters of the means */
    double measured_by[2][COLUMNS];
    double angle_by[2][2 * FO_ORDERS]; /* of by_angle, by the harmonics */
} prediction;

/* A measurement update. */
typedef struct {
    fo_dual e[2], V[2][2], w[2], K[FO_STATES][2]; /* V: inverse of the covariance; w = V e */
    fo_dual S[2][2], det;
    double angle; /* of the state before it, from the course */
} update;

#define FO_LIST(order) order,
static const int orders[FO_ORDERS] = {FO_HARMONICS(FO_LIST)};
#undef FO_LIST

const unsigned char fo_pattern[FO_ELEMENTS][2] = {
    {0, 0}, {0, 1}, {0, FO_ANGLE}, {0, FO_SPEED}, {0, FO_DRIFT}, {0, FO_DRIFT + 1},
    {1, 0}, {1, 1}, {1, FO_ANGLE}, {1, FO_SPEED}, {1, FO_DRIFT}, {1, FO_DRIFT + 1},
    {FO_ANGLE, FO_ANGLE}, {FO_ANGLE, FO_SPEED}, {FO_ANGLE, FO_ACCELERATION},
    {FO_SPEED, 0}, {FO_SPEED, 1}, {FO_SPEED, FO_ANGLE}, {FO_SPEED, FO_SPEED},
    {FO_SPEED, FO_ACCELERATION},
    {FO_ACCELERATION, FO_ACCELERATION}, {FO_DRIFT, FO_DRIFT},
    {FO_DRIFT + 1, FO_DRIFT + 1},
    {FO_NOISE, FO_NOISE}, {FO_NOISE, 0}, {FO_NOISE, 1}, {FO_NOISE, FO_ANGLE},
    {FO_NOISE + 1, FO_NOISE + 1}, {FO_NOISE + 1, 0}, {FO_NOISE + 1, 1}, {FO_NOISE + 1, FO_ANGLE}};

/* An element; a constant one has no derivatives. */
typedef struct {
    fo_dual value;
    bool constant;
} element;
typedef struct {
    element at[FO_ELEMENTS];
    int count;
} transition;

static fo_dual variance(double logarithm, int index)
{
    return fo_exp_of(fo_scale(2.0, fo_unknown(logarithm, index)));
}

static fo_dual positive(const double *p, int index)
{
    return fo_exp_of(fo_unknown(p[index], index));
}

static model model_of(const double p[FO_UNKNOWNS])
{
    model m;
    m.R = positive(p, FO_L_resistance);
    m.inverse_d = fo_inverse(positive(p, FO_L_L_d));
    m.inverse_q = fo_inverse(positive(p, FO_L_L_q));
    m.psi = positive(p, FO_L_psi_f);
    m.mobility = fo_unknown(p[FO_L_mobility], FO_L_mobility);
    m.pole = fo_unknown(p[FO_L_colour_pole], FO_L_colour_pole);
    m.colour = fo_unknown(p[FO_L_colour_gain], FO_L_colour_gain);
    m.noise = variance(p[FO_L_noise], FO_L_noise);
    m.acceleration = variance(p[FO_L_acceleration], FO_L_acceleration);
    m.voltage = variance(p[FO_L_voltage], FO_L_voltage);
    m.drift = variance(p[FO_L_drift], FO_L_drift);
    m.loss = exp(p[FO_L_loss]);
    m.inverse_knee = exp(-p[FO_L_knee]);
    m.lag = p[FO_L_lag] + p[FO_L_delay]; /* in the time of the currents */
    m.iron = p[FO_L_iron_loss];
    m.heat = p[FO_L_heat];
    m.offset[A] = p[FO_L_offset_alpha];
    m.offset[B] = p[FO_L_offset_beta];
    m.unequal[A] = p[FO_L_gain_re];
    m.unequal[B] = p[FO_L_gain_im];
    m.harmonics = p + FO_L;
    m.is_coloured = p[FO_L_colour_pole] != 0.0 || p[FO_L_colour_gain] != 0.0;
    return m;
}

/* r ← x turned by the angle of (c, s). */
static fo_pair turned(fo_pair x, double c, double s)
{
    const fo_pair r = {fo_axpy(fo_scale(c, x.a), -s, x.b), fo_axpy(fo_scale(s, x.a), c, x.b)};
    return r;
}

/* i = e^{jθ} L⁻¹ (e^{−jθ} λ − ψ − Σ a e^{jhθ}). If the rotor turns by δ, e^{−jθ} λ turns by −δ:
 * ∂i/∂θ = e^{jθ} [j i − L⁻¹ (j λ + Σ j h a e^{jhθ})] in rotor coordinates. */
static void predict(const model *m, const fo_course *at, double speed, prediction *p)
{
    const double c = cos(at->angle), s = sin(at->angle);
    const double flux[2] = {c * at->flux[A] + s * at->flux[B], c * at->flux[B] - s * at->flux[A]};
    const double inverse[2] = {m->inverse_d.d[0], m->inverse_q.d[0]};
    double harmonic[2] = {0.0, 0.0}, slope[2] = {0.0, 0.0};
    memset(p->by, 0, sizeof p->by);
    double power[2] = {1.0, 0.0}, powers[7][2];
    for (int n = 1; n <= 6; n++) {
        const double a = power[A] * c - power[B] * s, b = power[A] * s + power[B] * c;
        powers[n][A] = power[A] = a;
        powers[n][B] = power[B] = b;
    }
    for (int n = 0; n < FO_ORDERS; n++) {
        const int order = orders[n], size = order < 0 ? -order : order;
        const double u = powers[size][A], v = order < 0 ? -powers[size][B] : powers[size][B];
        const double a = m->harmonics[2 * n], b = m->harmonics[2 * n + 1];
        const double x = a * u - b * v, y = a * v + b * u;
        harmonic[A] += x;
        harmonic[B] += y;
        slope[A] -= order * y;
        slope[B] += order * x;
        /* −e^{jθ} L⁻¹ e^{jhθ} (a + j b) */
        const double d = inverse[A] * u, q = inverse[B] * v, e = -inverse[A] * v, f = inverse[B] * u;
        double *by_a = &p->by[A][FO_L - FO_C + 2 * n], *by_b = &p->by[B][FO_L - FO_C + 2 * n];
        by_a[0] = -(c * d - s * q);
        by_b[0] = -(s * d + c * q);
        by_a[1] = -(c * e - s * f);
        by_b[1] = -(s * e + c * f);
        /* −e^{jθ} (j L⁻¹ + L⁻¹ j h) e^{jhθ} (a + j b) */
        const double x_a = q + inverse[A] * order * v, y_a = -d - inverse[B] * order * u;
        const double x_b = f + inverse[A] * order * u, y_b = -e + inverse[B] * order * v;
        p->angle_by[A][2 * n] = c * x_a - s * y_a;
        p->angle_by[B][2 * n] = s * x_a + c * y_a;
        p->angle_by[A][2 * n + 1] = c * x_b - s * y_b;
        p->angle_by[B][2 * n + 1] = s * x_b + c * y_b;
    }
    const fo_pair i = {
        fo_mul(fo_shift(flux[A] - harmonic[A], fo_scale(-1.0, m->psi)), m->inverse_d),
        fo_scale(flux[B] - harmonic[B], m->inverse_q)};
    p->current = turned(i, c, s);
    /* Iron: j ω λ is the induced voltage. */
    const double induced[2] = {-speed * at->flux[B], speed * at->flux[A]};
    p->by[A][FO_L_iron_loss - FO_C] = induced[A];
    p->by[B][FO_L_iron_loss - FO_C] = induced[B];
    p->terminal = (fo_pair){fo_shift(m->iron * induced[A], p->current.a),
                            fo_shift(m->iron * induced[B], p->current.b)};
    const fo_pair t = p->terminal;
    const double g = m->unequal[A], k = m->unequal[B];
    p->measured = (fo_pair){fo_shift(m->offset[A], fo_axpy(fo_scale(1.0 + g, t.a), k, t.b)),
                            fo_shift(m->offset[B], fo_axpy(fo_scale(1.0 - g, t.b), k, t.a))};
    for (int n = 0; n < COLUMNS; n++) {
        p->measured_by[A][n] = (1.0 + g) * p->by[A][n] + k * p->by[B][n];
        p->measured_by[B][n] = (1.0 - g) * p->by[B][n] + k * p->by[A][n];
    }
    p->measured_by[A][FO_L_offset_alpha - FO_C] = 1.0;
    p->measured_by[B][FO_L_offset_beta - FO_C] = 1.0;
    p->measured_by[A][FO_L_gain_re - FO_C] = t.a.d[0];
    p->measured_by[B][FO_L_gain_re - FO_C] = -t.b.d[0];
    p->measured_by[A][FO_L_gain_im - FO_C] = t.b.d[0];
    p->measured_by[B][FO_L_gain_im - FO_C] = t.a.d[0];
    const fo_pair by_angle = {fo_axpy(fo_scale(flux[B] - slope[A], m->inverse_d), -1.0, i.b),
                              fo_axpy(fo_scale(-flux[A] - slope[B], m->inverse_q), 1.0, i.a)};
    const fo_pair in_stator = turned(by_angle, c, s);
    p->by_angle[A] = in_stator.a;
    p->by_angle[B] = in_stator.b;
    p->by_flux[A][A] = fo_axpy(fo_scale(c * c, m->inverse_d), s * s, m->inverse_q);
    p->by_flux[B][B] = fo_axpy(fo_scale(s * s, m->inverse_d), c * c, m->inverse_q);
    p->by_flux[A][B] = p->by_flux[B][A] =
        fo_axpy(fo_scale(c * s, m->inverse_d), -c * s, m->inverse_q);
}

/* Sum of the phases' smoothed signs as a vector, amplitude-invariant, with its derivatives by the
 * current and by ln knee. */
typedef struct {
    double value[2], by_current[2][2], by_knee[2];
} signs;

static signs signs_of(const model *m, double i_a, double i_b)
{
    static const double phase[3][2] = {
        {1.0, 0.0}, {-0.5, 0.86602540378443864676}, {-0.5, -0.86602540378443864676}};
    signs s;
    memset(&s, 0, sizeof s);
    for (int n = 0; n < 3; n++) {
        const double *d = phase[n], x = m->inverse_knee * (d[A] * i_a + d[B] * i_b);
        const double t = tanh(x), slope = 1.0 - t * t;
        for (int a = 0; a < 2; a++) {
            s.value[a] += 2.0 / 3.0 * d[a] * t;
            s.by_knee[a] -= 2.0 / 3.0 * d[a] * slope * x;
            for (int b = 0; b < 2; b++)
                s.by_current[a][b] += 2.0 / 3.0 * d[a] * d[b] * slope * m->inverse_knee;
        }
    }
    return s;
}

static void start_at(const model *m, const fo_course *course, const fo_start *start, double speed,
                     state *x, sensitivity by_means)
{
    memset(x, 0, sizeof *x);
    memset(by_means, 0, sizeof(sensitivity));
    x->states = m->is_coloured ? FO_STATES : FO_WHITE;
    x->x[FO_FLUX] = fo_constant(course->flux[A]);
    x->x[FO_FLUX + 1] = fo_constant(course->flux[B]);
    x->x[FO_ANGLE] = fo_constant(course->angle);
    x->x[FO_SPEED] = fo_constant(speed);
    const double stds[FO_WHITE] = {start->flux_std,  start->flux_std,         start->angle_std,
                                   start->speed_std, start->acceleration_std, start->drift_std,
                                   start->drift_std};
    for (int r = 0; r < FO_WHITE; r++) x->P[r][r] = fo_constant(stds[r] * stds[r]);
    if (m->is_coloured)
        x->P[FO_NOISE][FO_NOISE] = x->P[FO_NOISE + 1][FO_NOISE + 1] =
            fo_mul(fo_mul(m->colour, m->colour), m->noise);
}

/* Measurement update. */
static bool measure(const model *m, const double measured[2], const fo_course *at,
                    const prediction *p, state *x, update *z)
{
    const int states = x->states;
    const fo_dual flux[2] = {fo_shift(-at->flux[A], x->x[FO_FLUX]),
                             fo_shift(-at->flux[B], x->x[FO_FLUX + 1])};
    const fo_dual angle = fo_shift(-at->angle, x->x[FO_ANGLE]);
    fo_dual PH[FO_STATES][2];
    z->angle = angle.d[0];
    for (int a = 0; a < 2; a++) {
        const fo_dual i = a ? p->measured.b : p->measured.a;
        fo_dual e = fo_shift(measured[a], fo_scale(-1.0, i));
        fo_reduce(&e, &p->by_flux[a][A], &flux[A]);
        fo_reduce(&e, &p->by_flux[a][B], &flux[B]);
        fo_reduce(&e, &p->by_angle[a], &angle);
        if (states > FO_WHITE) e = fo_sub(e, x->x[FO_NOISE + a]);
        z->e[a] = e;
        for (int r = 0; r < states; r++) {
            const fo_dual *P = x->P[r];
            fo_product(&PH[r][a], &P[FO_FLUX], &p->by_flux[a][A]);
            fo_accumulate(&PH[r][a], &P[FO_FLUX + 1], &p->by_flux[a][B]);
            fo_accumulate(&PH[r][a], &P[FO_ANGLE], &p->by_angle[a]);
            if (states > FO_WHITE) PH[r][a] = fo_add(PH[r][a], P[FO_NOISE + a]);
        }
    }
    for (int a = 0; a < 2; a++)
        for (int b = a; b < 2; b++) {
            fo_dual S = a == b ? m->noise : fo_constant(0.0);
            fo_accumulate(&S, &p->by_flux[a][A], &PH[FO_FLUX][b]);
            fo_accumulate(&S, &p->by_flux[a][B], &PH[FO_FLUX + 1][b]);
            fo_accumulate(&S, &p->by_angle[a], &PH[FO_ANGLE][b]);
            if (states > FO_WHITE) S = fo_add(S, PH[FO_NOISE + a][b]);
            z->S[a][b] = z->S[b][a] = S;
        }
    z->det = fo_msub(fo_mul(z->S[0][0], z->S[1][1]), z->S[0][1], z->S[0][1]);
    if (!(z->det.d[0] > 0.0) || !isfinite(z->det.d[0]) || !isfinite(z->e[0].d[0])) return false;
    const fo_dual inverse = fo_inverse(z->det);
    z->V[0][0] = fo_mul(z->S[1][1], inverse);
    z->V[0][1] = z->V[1][0] = fo_scale(-1.0, fo_mul(z->S[0][1], inverse));
    z->V[1][1] = fo_mul(z->S[0][0], inverse);
    for (int a = 0; a < 2; a++) {
        fo_product(&z->w[a], &z->V[a][0], &z->e[0]);
        fo_accumulate(&z->w[a], &z->V[a][1], &z->e[1]);
    }
    for (int r = 0; r < states; r++) {
        for (int a = 0; a < 2; a++) {
            fo_product(&z->K[r][a], &PH[r][0], &z->V[0][a]);
            fo_accumulate(&z->K[r][a], &PH[r][1], &z->V[1][a]);
            fo_accumulate(&x->x[r], &PH[r][a], &z->w[a]);
        }
        for (int c = r; c < states; c++) {
            fo_reduce(&x->P[r][c], &z->K[r][0], &PH[c][0]);
            fo_reduce(&x->P[r][c], &z->K[r][1], &PH[c][1]);
            x->P[c][r] = x->P[r][c];
        }
    }
    fo_product(&x->residual.a, &m->noise, &z->w[A]);
    fo_product(&x->residual.b, &m->noise, &z->w[B]);
    x->measured = true;
    return true;
}

/* Derivatives of the innovation by all parameters, and the update of those of the state by the
 * parameters of the means. */
static void error_derivatives(const prediction *p, const update *z, int states, sensitivity x,
                              double by[2][FO_UNKNOWNS])
{
    for (int a = 0; a < 2; a++) {
        for (int k = 0; k < FO_C; k++) by[a][k] = z->e[a].d[k + 1];
        for (int k = 0; k < COLUMNS; k++) {
            double e = -p->measured_by[a][k] - p->by_flux[a][A].d[0] * x[FO_FLUX][k] -
                       p->by_flux[a][B].d[0] * x[FO_FLUX + 1][k] -
                       p->by_angle[a].d[0] * x[FO_ANGLE][k];
            if (states > FO_WHITE) e -= x[FO_NOISE + a][k];
            by[a][FO_C + k] = e;
        }
        for (int k = 0; k < 2 * FO_ORDERS; k++) by[a][FO_L + k] -= p->angle_by[a][k] * z->angle;
    }
    for (int r = 0; r < states; r++)
        for (int k = 0; k < COLUMNS; k++)
            x[r][k] += z->K[r][0].d[0] * by[0][FO_C + k] + z->K[r][1].d[0] * by[1][FO_C + k];
}

/* Adds a row to the objective, the score and the information. */
static void count(const update *z, double by[2][FO_UNKNOWNS], fo_likelihood *out)
{
    const fo_dual square = fo_mac(fo_mul(z->e[0], z->w[0]), z->e[1], z->w[1]);
    const double inverse = 1.0 / z->det.d[0];
    out->objective += 0.5 * (square.d[0] + log(z->det.d[0]));
    out->mean_square += 0.5 * square.d[0];
    out->counted++;
    for (int k = 0; k < FO_C; k++)
        out->score[k] += 0.5 * (square.d[k + 1] + z->det.d[k + 1] * inverse);
    for (int k = FO_C; k < FO_UNKNOWNS; k++)
        out->score[k] += by[0][k] * z->w[0].d[0] + by[1][k] * z->w[1].d[0];
    for (int r = 0; r < FO_UNKNOWNS; r++) {
        const double a = z->V[0][0].d[0] * by[0][r] + z->V[0][1].d[0] * by[1][r];
        const double b = z->V[1][0].d[0] * by[0][r] + z->V[1][1].d[0] * by[1][r];
        double *row = out->information + r * FO_UNKNOWNS;
        for (int c = 0; c <= r; c++) row[c] += a * by[0][c] + b * by[1][c];
    }
    /* ½ tr(S⁻¹ ∂S S⁻¹ ∂S) */
    double VS[2][2][FO_C];
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++)
            for (int k = 0; k < FO_C; k++)
                VS[a][b][k] = z->V[a][0].d[0] * z->S[0][b].d[k + 1] +
                              z->V[a][1].d[0] * z->S[1][b].d[k + 1];
    for (int r = 0; r < FO_C; r++)
        for (int c = 0; c <= r; c++)
            out->information[r * FO_UNKNOWNS + c] +=
                0.5 * (VS[0][0][r] * VS[0][0][c] + VS[0][1][r] * VS[1][0][c] +
                       VS[1][0][r] * VS[0][1][c] + VS[1][1][r] * VS[1][1][c]);
}

static void put(transition *F, fo_dual value)
{
    element *e = &F->at[F->count++];
    e->value = value;
    e->constant = false;
}

static void put_constant(transition *F, double value)
{
    element *e = &F->at[F->count++];
    e->value = fo_constant(value);
    e->constant = true;
}

/* r ← r + e x, or e x if r is not written yet. */
static void apply(const element *e, const fo_dual *x, fo_dual *r, bool written)
{
    if (!e->constant)
        (written ? fo_accumulate : fo_product)(r, &e->value, x);
    else if (written)
        fo_accumulate_scaled(r, e->value.d[0], x);
    else
        *r = fo_scale(e->value.d[0], *x);
}

/* P ← F P Fᵀ */
static void move_covariance(const transition *F, state *x)
{
    fo_dual M[FO_STATES][FO_STATES];
    bool written[FO_STATES] = {false};
    const int states = x->states;
    for (int k = 0; k < F->count; k++) {
        const int row = fo_pattern[k][0], column = fo_pattern[k][1];
        for (int c = 0; c < states; c++)
            apply(&F->at[k], &x->P[column][c], &M[row][c], written[row]);
        written[row] = true;
    }
    memset(written, 0, sizeof written);
    for (int k = 0; k < F->count; k++) {
        const int row = fo_pattern[k][0], column = fo_pattern[k][1];
        for (int r = 0; r <= row; r++) apply(&F->at[k], &M[r][column], &x->P[r][row], written[row]);
        written[row] = true;
    }
    for (int r = 0; r < states; r++)
        for (int c = 0; c < r; c++) x->P[r][c] = x->P[c][r];
}

/* An interval: its voltages and both rows of the course. */
typedef struct {
    double h, now[2], before[2];
    double place; /* of the interval in the log, from 0 to 1 */
    const fo_course *from, *to;
    const prediction *at, *next;
} interval;

/* The electrical part of an interval. Flux and current change within it: with X = h (R + S') ∂i/∂λ the
 * current at its end counts W = ½ + Xᵀ/12 in its mean (the series of 1/(1 − e^{−x}) − 1/x), and
 * λ⁺ = λ̄⁺ + M r with M = (1 + X/2 + X²/12)⁻¹: the flux decays by the Padé approximation of e^{−X}. */
typedef struct {
    fo_dual W[2][2];
    fo_dual R;             /* now [Ω] */
    fo_dual slope[2][2];   /* h (R + S') */
    fo_dual half[2][2];    /* X/2 − X²/12 */
    fo_dual M[2][2];
    fo_pair mean;          /* mean current of the course */
    signs sign;
} electrical;

/* Mean of the course's current: its ends, weighted, less a twelfth of its second difference, by which
 * ∂i/∂θ and ∂i/∂λ turn with the rotor. */
static fo_pair mean_current(const interval *t, fo_dual W[2][2])
{
    const fo_dual step[2] = {fo_sub(t->next->terminal.a, t->at->terminal.a),
                             fo_sub(t->next->terminal.b, t->at->terminal.b)};
    const double turn = t->to->angle - t->from->angle;
    const double change[2] = {t->to->flux[A] - t->from->flux[A], t->to->flux[B] - t->from->flux[B]};
    fo_dual mean[2];
    for (int a = 0; a < 2; a++) {
        mean[a] = a ? t->at->terminal.b : t->at->terminal.a;
        for (int b = 0; b < 2; b++) fo_accumulate(&mean[a], &W[a][b], &step[b]);
        fo_dual bend = fo_scale(turn, fo_sub(t->next->by_angle[a], t->at->by_angle[a]));
        for (int b = 0; b < 2; b++)
            bend = fo_axpy(bend, change[b], fo_sub(t->next->by_flux[a][b], t->at->by_flux[a][b]));
        fo_accumulate_scaled(&mean[a], -1.0 / 12.0, &bend);
    }
    const fo_pair r = {mean[A], mean[B]};
    return r;
}

static void matrix_product(fo_dual x[2][2], fo_dual y[2][2], fo_dual out[2][2])
{
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            fo_product(&out[a][b], &x[a][0], &y[0][b]);
            fo_accumulate(&out[a][b], &x[a][1], &y[1][b]);
        }
}

static electrical electrical_of(const model *m, const interval *t)
{
    electrical e;
    const fo_pair *from = &t->at->terminal, *to = &t->next->terminal;
    const signs about = signs_of(m, 0.5 * (from->a.d[0] + to->a.d[0]), 0.5 * (from->b.d[0] + to->b.d[0]));
    e.R = fo_scale(1.0 + m->heat * t->place, m->R);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            e.slope[a][b] = fo_constant(t->h * m->loss * about.by_current[a][b]);
            if (a == b) e.slope[a][b] = fo_axpy(e.slope[a][b], t->h, e.R);
        }
    fo_dual by_flux[2][2], X[2][2], square[2][2], whole[2][2];
    memcpy(by_flux, t->at->by_flux, sizeof by_flux);
    matrix_product(e.slope, by_flux, X);
    matrix_product(X, X, square);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            e.W[a][b] = fo_shift(a == b ? 0.5 : 0.0, fo_scale(1.0 / 12.0, X[b][a]));
            e.half[a][b] = fo_axpy(fo_scale(0.5, X[a][b]), -1.0 / 12.0, square[a][b]);
            whole[a][b] = fo_axpy(fo_scale(0.5, X[a][b]), 1.0 / 12.0, square[a][b]);
            if (a == b) whole[a][b].d[0] += 1.0;
        }
    const fo_dual inverse =
        fo_inverse(fo_msub(fo_mul(whole[0][0], whole[1][1]), whole[0][1], whole[1][0]));
    fo_product(&e.M[0][0], &whole[1][1], &inverse);
    fo_product(&e.M[1][1], &whole[0][0], &inverse);
    e.M[0][1] = fo_scale(-1.0, fo_mul(whole[0][1], inverse));
    e.M[1][0] = fo_scale(-1.0, fo_mul(whole[1][0], inverse));
    e.mean = mean_current(t, e.W);
    e.sign = signs_of(m, e.mean.a.d[0], e.mean.b.d[0]);
    return e;
}

/* Flux after the interval, and its rows of the transition. `flux` and `angle`: deviations from the
 * course before it. */
static void move_flux(const model *m, const interval *t, const electrical *e, const fo_dual flux[2],
                      fo_dual angle, state *x, transition *F)
{
    const double h = t->h;
    const prediction *p = t->at;
    const double u[2] = {t->now[A] + m->lag * (t->before[A] - t->now[A]),
                         t->now[B] + m->lag * (t->before[B] - t->now[B])};
    /* How much more the angle turns than the course. */
    const fo_dual step = fo_shift(t->from->angle - t->to->angle, fo_scale(h, x->x[FO_SPEED]));
    fo_dual r[2], by_angle[2], by_step[2], late[2];
    for (int a = 0; a < 2; a++) {
        fo_product(&late[a], &e->W[a][A], &p->by_angle[A]);
        fo_accumulate(&late[a], &e->W[a][B], &p->by_angle[B]);
    }
    for (int a = 0; a < 2; a++) {
        const fo_dual i = a ? e->mean.b : e->mean.a;
        r[a] = fo_shift(h * u[a] - t->to->flux[a], x->x[FO_FLUX + a]);
        fo_accumulate_scaled(&r[a], -h, &x->x[FO_DRIFT + a]);
        r[a] = fo_axpy(r[a], -h, fo_mul(e->R, i));
        r[a].d[0] -= h * m->loss * e->sign.value[a];
        for (int k = 1; k < FO_WIDTH; k++)
            r[a].d[k] -= h * m->loss * (e->sign.by_current[a][A] * e->mean.a.d[k] +
                                        e->sign.by_current[a][B] * e->mean.b.d[k]);
        fo_product(&by_angle[a], &e->slope[a][A], &p->by_angle[A]);
        fo_accumulate(&by_angle[a], &e->slope[a][B], &p->by_angle[B]);
        fo_product(&by_step[a], &e->slope[a][A], &late[A]);
        fo_accumulate(&by_step[a], &e->slope[a][B], &late[B]);
        fo_reduce(&r[a], &by_angle[a], &angle);
        fo_reduce(&r[a], &by_step[a], &step);
        for (int b = 0; b < 2; b++) fo_reduce(&r[a], &e->half[a][b], &flux[b]);
    }
    for (int a = 0; a < 2; a++) {
        const fo_dual *M = e->M[a];
        for (int b = 0; b < 2; b++) {
            fo_dual kept = M[b];
            fo_reduce(&kept, &M[A], &e->half[A][b]);
            fo_reduce(&kept, &M[B], &e->half[B][b]);
            put(F, kept);
        }
        put(F, fo_scale(-1.0, fo_mac(fo_mul(M[A], by_angle[A]), M[B], by_angle[B])));
        put(F, fo_scale(-h, fo_mac(fo_mul(M[A], by_step[A]), M[B], by_step[B])));
        put(F, fo_scale(-h, M[A]));
        put(F, fo_scale(-h, M[B]));
        fo_dual moved = fo_shift(t->to->flux[a], fo_mul(M[A], r[A]));
        fo_accumulate(&moved, &M[B], &r[B]);
        x->x[FO_FLUX + a] = moved;
    }
}

/* Angle and speed after the interval, with their rows of the transition: the torque is 3/2 n_p times
 * flux × current. */
static void move_rotor(const model *m, const interval *t, const fo_dual flux[2], fo_dual angle,
                       state *x, transition *F)
{
    const double h = t->h, *course = t->from->flux;
    const prediction *p = t->at;
    const fo_dual torque = fo_axpy(fo_scale(course[A], p->current.b), -course[B], p->current.a);
    const fo_dual mobility = fo_scale(h, m->mobility);
    const fo_dual by[3] = {
        fo_mul(mobility, fo_add(fo_axpy(fo_scale(course[A], p->by_flux[B][A]), -course[B],
                                        p->by_flux[A][A]), p->current.b)),
        fo_mul(mobility, fo_sub(fo_axpy(fo_scale(course[A], p->by_flux[B][B]), -course[B],
                                        p->by_flux[A][B]), p->current.a)),
        fo_mul(mobility, fo_axpy(fo_scale(course[A], p->by_angle[B]), -course[B], p->by_angle[A]))};
    put_constant(F, 1.0);
    put_constant(F, h);
    put_constant(F, 0.5 * h * h);
    for (int k = 0; k < 3; k++) put(F, by[k]);
    put_constant(F, 1.0);
    put_constant(F, h);
    fo_dual speed = fo_axpy(fo_mul(mobility, torque), h, x->x[FO_ACCELERATION]);
    x->x[FO_ANGLE] = fo_axpy(fo_axpy(x->x[FO_ANGLE], h, x->x[FO_SPEED]), 0.5 * h, speed);
    fo_accumulate(&speed, &by[0], &flux[A]);
    fo_accumulate(&speed, &by[1], &flux[B]);
    fo_accumulate(&speed, &by[2], &angle);
    x->x[FO_SPEED] = fo_add(x->x[FO_SPEED], speed);
}

/* Predictable part of the noise after the interval. */
static void move_noise(const model *m, const prediction *p, state *x, transition *F)
{
    const fo_dual colour = x->measured ? m->colour : fo_constant(0.0);
    const fo_dual memory = fo_sub(m->pole, colour);
    for (int a = 0; a < 2; a++) {
        fo_dual n = fo_mul(m->pole, x->x[FO_NOISE + a]);
        fo_accumulate(&n, &m->colour, a ? &x->residual.b : &x->residual.a);
        x->x[FO_NOISE + a] = n;
        put(F, memory);
        for (int b = 0; b < 2; b++) put(F, fo_scale(-1.0, fo_mul(colour, p->by_flux[a][b])));
        put(F, fo_scale(-1.0, fo_mul(colour, p->by_angle[a])));
    }
}

/* Derivatives by the parameters of the means: F x, and what they change themselves. */
static void move_sensitivity(const model *m, const interval *t, const electrical *e,
                             const transition *F, double colour, sensitivity by)
{
    const double h = t->h, turning = h * m->mobility.d[0], *course = t->from->flux;
    const prediction *p = t->at;
    sensitivity next;
    memset(next, 0, sizeof next);
    for (int k = 0; k < F->count; k++) {
        const double f = F->at[k].value.d[0], *from = by[fo_pattern[k][1]];
        double *to = next[fo_pattern[k][0]];
        for (int j = 0; j < COLUMNS; j++) to[j] += f * from[j];
    }
    double r[2][COLUMNS];
    for (int j = 0; j < COLUMNS; j++) {
        double i[2];
        for (int a = 0; a < 2; a++) {
            i[a] = p->by[a][j];
            for (int b = 0; b < 2; b++)
                i[a] += e->W[a][b].d[0] * (t->next->by[b][j] - p->by[b][j]);
        }
        for (int a = 0; a < 2; a++) {
            r[a][j] = -h * (e->R.d[0] * i[a] + m->loss * (e->sign.by_current[a][A] * i[A] +
                                                          e->sign.by_current[a][B] * i[B]));
            next[FO_NOISE + a][j] -= colour * p->measured_by[a][j];
        }
        if (j == FO_L_iron_loss - FO_C) continue; /* its current makes no torque */
        const double more = turning * (course[A] * p->by[B][j] - course[B] * p->by[A][j]);
        next[FO_SPEED][j] += more;
        next[FO_ANGLE][j] += 0.5 * h * more;
    }
    for (int a = 0; a < 2; a++) {
        r[a][FO_L_heat - FO_C] -= h * t->place * m->R.d[0] * (a ? e->mean.b : e->mean.a).d[0];
        r[a][FO_L_loss - FO_C] -= h * m->loss * e->sign.value[a];
        r[a][FO_L_knee - FO_C] -= h * m->loss * e->sign.by_knee[a];
        r[a][FO_L_lag - FO_C] += h * (t->before[a] - t->now[a]);
        r[a][FO_L_delay - FO_C] += h * (t->before[a] - t->now[a]);
    }
    for (int a = 0; a < 2; a++)
        for (int j = 0; j < COLUMNS; j++)
            next[FO_FLUX + a][j] += e->M[a][A].d[0] * r[A][j] + e->M[a][B].d[0] * r[B][j];
    memcpy(by, next, sizeof next);
}

/* Time update over an interval. */
static void advance(const model *m, const interval *t, state *x, transition *F, sensitivity by)
{
    const electrical e = electrical_of(m, t);
    const fo_dual flux[2] = {fo_shift(-t->from->flux[A], x->x[FO_FLUX]),
                             fo_shift(-t->from->flux[B], x->x[FO_FLUX + 1])};
    const fo_dual angle = fo_shift(-t->from->angle, x->x[FO_ANGLE]);
    F->count = 0;
    move_flux(m, t, &e, flux, angle, x, F);
    move_rotor(m, t, flux, angle, x, F);
    for (int k = FO_ACCELERATION; k < FO_NOISE; k++) put_constant(F, 1.0);
    const double colour = x->measured ? m->colour.d[0] : 0.0;
    if (x->states > FO_WHITE) move_noise(m, t->at, x, F);
    move_sensitivity(m, t, &e, F, colour, by);
    move_covariance(F, x);
    const double passed = fabs(t->h);
    for (int a = 0; a < 2; a++) {
        fo_accumulate_scaled(&x->P[FO_FLUX + a][FO_FLUX + a], passed, &m->voltage);
        fo_accumulate_scaled(&x->P[FO_DRIFT + a][FO_DRIFT + a], passed, &m->drift);
    }
    fo_accumulate_scaled(&x->P[FO_ACCELERATION][FO_ACCELERATION], passed * t->from->unrest,
                         &m->acceleration);
    if (!x->measured && x->states > FO_WHITE) { /* w of this row is unknown */
        const fo_dual more = fo_mul(fo_mul(m->colour, m->colour), m->noise);
        for (int a = FO_NOISE; a < FO_STATES; a++) x->P[a][a] = fo_add(x->P[a][a], more);
    }
    x->measured = false;
    x->residual = fo_constant_pair(0.0, 0.0);
}

/* Keeps a row after its measurement update. */
static void keep_row(const state *x, const prediction *p, const update *z, sensitivity by_means,
                     double error_by[2][FO_UNKNOWNS], fo_row *row)
{
    static const int own_by[2] = {FO_ANGLE, FO_SPEED};
    memset(row, 0, sizeof *row);
    for (int r = 0; r < FO_OWN; r++) {
        row->own[r] = x->x[r].d[0];
        for (int c = 0; c < x->states; c++) row->P[r][c] = x->P[r][c].d[0];
    }
    for (int n = 0; n < 2; n++) {
        const int own = own_by[n];
        for (int k = 0; k < FO_C; k++) row->own_by[n][k] = x->x[own].d[k + 1];
        for (int k = 0; k < COLUMNS; k++) row->own_by[n][FO_C + k] = by_means[own][k];
    }
    row->measured = x->measured;
    if (!x->measured) return;
    memcpy(row->error_by, error_by, sizeof row->error_by);
    for (int a = 0; a < 2; a++) {
        row->error[a] = z->e[a].d[0];
        row->by_angle[a] = p->by_angle[a].d[0];
        for (int r = 0; r < x->states; r++) row->K[r][a] = z->K[r][a].d[0];
    }
    const int at[3][2] = {{0, 0}, {0, 1}, {1, 1}};
    for (int n = 0; n < 3; n++) {
        row->by_flux[n] = p->by_flux[at[n][0]][at[n][1]].d[0];
        row->inverse[n] = z->V[at[n][0]][at[n][1]].d[0];
    }
}

static void complete(fo_likelihood *out)
{
    if (out->counted) out->mean_square /= (double)out->counted;
    for (int r = 0; r < FO_UNKNOWNS; r++)
        for (int c = 0; c < r; c++)
            out->information[c * FO_UNKNOWNS + r] = out->information[r * FO_UNKNOWNS + c];
}

bool fo_innovations(const fo_log *log, const fo_course *course, const double parameters[FO_UNKNOWNS],
                    const fo_start *start, fo_likelihood *out, fo_row *kept)
{
    const model m = model_of(parameters);
    const double h = log->sample_time;
    state x;
    update z;
    transition F;
    sensitivity by_means;
    prediction at, next;
    double error_by[2][FO_UNKNOWNS], held[2] = {0.0, 0.0}, before[2];
    memset(out, 0, sizeof *out);
    const double speed = log->rows > 1 ? (course[1].angle - course[0].angle) / h : 0.0;
    start_at(&m, course, start, speed, &x, by_means);
    predict(&m, course, speed, &at);
    for (size_t k = 0; k < log->rows; k++) {
        const double *i = log->current + 2 * k, *u = log->voltage + 2 * k;
        const bool known = isfinite(u[0]) && isfinite(u[1]);
        memcpy(before, held, sizeof before);
        if (known) memcpy(held, u, sizeof held);
        if (k == 0) memcpy(before, held, sizeof before);
        if (isfinite(i[0]) && isfinite(i[1])) {
            if (!measure(&m, i, course + k, &at, &x, &z)) return false;
            error_derivatives(&at, &z, x.states, by_means, error_by);
            if (k >= start->skipped) count(&z, error_by, out);
        }
        if (!isfinite(x.x[FO_ANGLE].d[0])) return false;
        if (kept) keep_row(&x, &at, &z, by_means, error_by, kept + k);
        if (k + 1 == log->rows) break;
        const double turning = (course[k + 1].angle - course[k].angle) / h;
        predict(&m, course + k + 1, turning, &next);
        const interval t = {h, {held[0], held[1]}, {before[0], before[1]},
                            (double)k / (double)log->rows,
                            course + k, course + k + 1, &at, &next};
        advance(&m, &t, &x, &F, by_means);
        if (!known) { /* held, and as uncertain as it is large */
            const double more = 0.5 * h * h * (held[0] * held[0] + held[1] * held[1]);
            for (int a = 0; a < 2; a++) x.P[a][a].d[0] += more;
        }
        if (kept)
            for (int n = 0; n < F.count; n++) kept[k].F[n] = F.at[n].value.d[0];
        at = next;
    }
    complete(out);
    return true;
}
