#include "innovations.h"

#include <math.h>
#include <string.h>

#include "dual.h"

enum { A = FO_ALPHA, B = FO_BETA };

/* Derivatives of the states by the parameters that change the means only: the gain is the same. */
enum { COLUMNS = FO_COLUMNS };
typedef double sensitivity[FO_STATES][COLUMNS];

typedef struct {
    fo_dual x[FO_STATES];
    fo_dual P[FO_STATES][FO_STATES];
    fo_pair residual; /* of the last measurement, after its update */
    bool measured;
    int states;
} state;

/* A measurement update. */
typedef struct {
    fo_dual e[2], V[2][2], w[2], K[FO_STATES][2]; /* V: inverse of the covariance; w = V e */
    fo_dual S[2][2], det;
    double angle; /* of the state before it, from the course */
} update;

/* A cage's slip and rotor flux follow the current; other machines lack these elements. */
const unsigned char fo_pattern[FO_ELEMENTS][2] = {
    {0, 0}, {0, 1}, {0, FO_ANGLE}, {0, FO_SPEED}, {0, FO_PSI}, {0, FO_DRIFT}, {0, FO_DRIFT + 1},
    {1, 0}, {1, 1}, {1, FO_ANGLE}, {1, FO_SPEED}, {1, FO_PSI}, {1, FO_DRIFT}, {1, FO_DRIFT + 1},
    {FO_ANGLE, FO_SPEED}, {FO_ANGLE, FO_ACCELERATION},
    {FO_ANGLE, 0}, {FO_ANGLE, 1}, {FO_ANGLE, FO_ANGLE}, {FO_ANGLE, FO_PSI},
    {FO_SPEED, 0}, {FO_SPEED, 1}, {FO_SPEED, FO_ANGLE}, {FO_SPEED, FO_PSI}, {FO_SPEED, FO_SPEED},
    {FO_SPEED, FO_ACCELERATION},
    {FO_PSI, 0}, {FO_PSI, 1}, {FO_PSI, FO_ANGLE}, {FO_PSI, FO_PSI},
    {FO_ACCELERATION, FO_ACCELERATION}, {FO_DRIFT, FO_DRIFT},
    {FO_DRIFT + 1, FO_DRIFT + 1},
    {FO_NOISE, FO_NOISE}, {FO_NOISE, 0}, {FO_NOISE, 1}, {FO_NOISE, FO_ANGLE}, {FO_NOISE, FO_PSI},
    {FO_NOISE + 1, FO_NOISE + 1}, {FO_NOISE + 1, 0}, {FO_NOISE + 1, 1}, {FO_NOISE + 1, FO_ANGLE},
    {FO_NOISE + 1, FO_PSI}};

typedef enum { GENERAL, CONSTANT, ABSENT } kind;

/* An element; a constant one has no derivatives. */
typedef struct {
    fo_dual value;
    kind kind;
} element;
typedef struct {
    element at[FO_ELEMENTS];
    int count;
} transition;

static void start_at(const fo_model *m, const fo_course *course, const fo_start *start, double speed,
                     state *x, sensitivity by_means)
{
    memset(x, 0, sizeof *x);
    memset(by_means, 0, sizeof(sensitivity));
    x->states = m->is_coloured ? FO_STATES : FO_WHITE;
    x->x[FO_FLUX] = fo_constant(course->flux[A]);
    x->x[FO_FLUX + 1] = fo_constant(course->flux[B]);
    x->x[FO_ANGLE] = fo_constant(course->angle);
    x->x[FO_SPEED] = fo_constant(speed);
    x->x[FO_PSI] = fo_constant(course->psi);
    const double stds[FO_WHITE] = {start->flux_std,  start->flux_std,  start->angle_std,
                                   start->speed_std, start->psi_std,   start->acceleration_std,
                                   start->drift_std, start->drift_std};
    for (int r = 0; r < FO_WHITE; r++) x->P[r][r] = fo_constant(stds[r] * stds[r]);
    if (m->is_coloured)
        x->P[FO_NOISE][FO_NOISE] = x->P[FO_NOISE + 1][FO_NOISE + 1] =
            fo_mul(fo_mul(m->colour, m->colour), m->noise);
}

/* Derivatives of the measured current. */
typedef struct {
    fo_dual by_flux[2][2], by_angle[2], by_psi[2];
} measurement;

static fo_dual sensed(const fo_prediction *p, int a, const fo_dual *x, const fo_dual *y)
{
    return fo_axpy(fo_scale(p->sensed[a][A], *x), p->sensed[a][B], *y);
}

static measurement measurement_of(const fo_prediction *p)
{
    measurement H;
    memcpy(H.by_flux, p->by_flux, sizeof H.by_flux);
    memcpy(H.by_angle, p->by_angle, sizeof H.by_angle);
    memcpy(H.by_psi, p->by_psi, sizeof H.by_psi);
    if (!p->clipped) return H;
    for (int a = 0; a < 2; a++) {
        for (int b = 0; b < 2; b++)
            H.by_flux[a][b] = sensed(p, a, &p->by_flux[A][b], &p->by_flux[B][b]);
        H.by_angle[a] = sensed(p, a, &p->by_angle[A], &p->by_angle[B]);
        H.by_psi[a] = sensed(p, a, &p->by_psi[A], &p->by_psi[B]);
    }
    return H;
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

/* Measurement update. */
static bool measure(const fo_model *m, const double measured[2], const fo_course *at,
                    const fo_prediction *p, const measurement *H, state *x, update *z)
{
    const int states = x->states;
    const fo_dual flux[2] = {fo_shift(-at->flux[A], x->x[FO_FLUX]),
                             fo_shift(-at->flux[B], x->x[FO_FLUX + 1])};
    const fo_dual angle = fo_shift(-at->angle, x->x[FO_ANGLE]);
    const fo_dual psi = fo_shift(-at->psi, x->x[FO_PSI]);
    fo_dual PH[FO_STATES][2];
    z->angle = angle.d[0];
    for (int a = 0; a < 2; a++) {
        const fo_dual i = a ? p->measured.b : p->measured.a;
        fo_dual e = fo_shift(measured[a], fo_scale(-1.0, i));
        fo_reduce(&e, &H->by_flux[a][A], &flux[A]);
        fo_reduce(&e, &H->by_flux[a][B], &flux[B]);
        fo_reduce(&e, &H->by_angle[a], &angle);
        fo_reduce(&e, &H->by_psi[a], &psi);
        if (states > FO_WHITE) e = fo_sub(e, x->x[FO_NOISE + a]);
        z->e[a] = e;
        for (int r = 0; r < states; r++) {
            const fo_dual *P = x->P[r];
            fo_product(&PH[r][a], &P[FO_FLUX], &H->by_flux[a][A]);
            fo_accumulate(&PH[r][a], &P[FO_FLUX + 1], &H->by_flux[a][B]);
            fo_accumulate(&PH[r][a], &P[FO_ANGLE], &H->by_angle[a]);
            fo_accumulate(&PH[r][a], &P[FO_PSI], &H->by_psi[a]);
            if (states > FO_WHITE) PH[r][a] = fo_add(PH[r][a], P[FO_NOISE + a]);
        }
    }
    for (int a = 0; a < 2; a++)
        for (int b = a; b < 2; b++) {
            fo_dual S = fo_scale(at->doubt * noise_of(p, a, b), m->noise);
            fo_accumulate(&S, &H->by_flux[a][A], &PH[FO_FLUX][b]);
            fo_accumulate(&S, &H->by_flux[a][B], &PH[FO_FLUX + 1][b]);
            fo_accumulate(&S, &H->by_angle[a], &PH[FO_ANGLE][b]);
            fo_accumulate(&S, &H->by_psi[a], &PH[FO_PSI][b]);
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
    const fo_dual noise = fo_scale(at->doubt, m->noise);
    fo_product(&x->residual.a, &noise, &z->w[A]);
    fo_product(&x->residual.b, &noise, &z->w[B]);
    x->measured = true;
    return true;
}

/* Derivatives of the innovation by all parameters, and the update of those of the state by the
 * parameters of the means. */
static void error_derivatives(const fo_prediction *p, const measurement *H, const update *z,
                              int states, sensitivity x, double by[2][FO_UNKNOWNS])
{
    for (int a = 0; a < 2; a++) {
        for (int k = 0; k < FO_C; k++) by[a][k] = z->e[a].d[k + 1];
        for (int k = 0; k < COLUMNS; k++) {
            double e = -p->measured_by[a][k] - H->by_flux[a][A].d[0] * x[FO_FLUX][k] -
                       H->by_flux[a][B].d[0] * x[FO_FLUX + 1][k] -
                       H->by_angle[a].d[0] * x[FO_ANGLE][k] - H->by_psi[a].d[0] * x[FO_PSI][k];
            if (states > FO_WHITE) e -= x[FO_NOISE + a][k];
            by[a][FO_C + k] = e;
        }
        for (int k = 0; k < 2 * FO_ORDERS; k++)
            by[a][FO_L + k] -= z->angle * (p->sensed[a][A] * p->angle_by[A][k] +
                                           p->sensed[a][B] * p->angle_by[B][k]);
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
    e->kind = GENERAL;
}

static void put_constant(transition *F, double value)
{
    element *e = &F->at[F->count++];
    e->value = fo_constant(value);
    e->kind = CONSTANT;
}

static void put_nothing(transition *F, int count)
{
    for (int k = 0; k < count; k++) {
        put_constant(F, 0.0);
        F->at[F->count - 1].kind = ABSENT;
    }
}

/* r ← r + e x, or e x if r is not written yet. */
static void apply(const element *e, const fo_dual *x, fo_dual *r, bool written)
{
    if (e->kind == GENERAL)
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
        if (F->at[k].kind == ABSENT) continue;
        for (int c = 0; c < states; c++)
            apply(&F->at[k], &x->P[column][c], &M[row][c], written[row]);
        written[row] = true;
    }
    memset(written, 0, sizeof written);
    for (int k = 0; k < F->count; k++) {
        const int row = fo_pattern[k][0], column = fo_pattern[k][1];
        if (F->at[k].kind == ABSENT) continue;
        for (int r = 0; r <= row; r++) apply(&F->at[k], &M[r][column], &x->P[r][row], written[row]);
        written[row] = true;
    }
    for (int r = 0; r < states; r++)
        for (int c = 0; c < r; c++) x->P[r][c] = x->P[c][r];
}

/* An interval: its voltage, the derivative of this by the lag, and both rows of the course. */
typedef struct {
    double h, now[2], late[2];
    double place; /* of the interval in the log, from 0 to 1 */
    const fo_course *from, *to;
    const fo_prediction *at, *next;
    const measurement *sensed; /* at the row before it */
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
    fo_signs sign;         /* of the middle one */
} electrical;

/* Mean and middle of the course's current: its ends, weighted, less a twelfth and an eighth of its second
 * difference, by which ∂i/∂θ and ∂i/∂λ turn with the rotor. */
static void currents_of(const interval *t, electrical *e)
{
    const fo_dual step[2] = {fo_sub(t->next->terminal.a, t->at->terminal.a),
                             fo_sub(t->next->terminal.b, t->at->terminal.b)};
    const double turn = t->to->angle - t->from->angle;
    const double change[2] = {t->to->flux[A] - t->from->flux[A], t->to->flux[B] - t->from->flux[B]};
    fo_dual mean[2], middle[2];
    for (int a = 0; a < 2; a++) {
        mean[a] = a ? t->at->terminal.b : t->at->terminal.a;
        middle[a] = fo_axpy(mean[a], 0.5, step[a]);
        for (int b = 0; b < 2; b++) fo_accumulate(&mean[a], &e->W[a][b], &step[b]);
        fo_dual bend = fo_scale(turn, fo_sub(t->next->by_angle[a], t->at->by_angle[a]));
        for (int b = 0; b < 2; b++)
            bend = fo_axpy(bend, change[b], fo_sub(t->next->by_flux[a][b], t->at->by_flux[a][b]));
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
    const fo_signs about = fo_signs_of(m, 0.5 * (from->a.d[0] + to->a.d[0]),
                                       0.5 * (from->b.d[0] + to->b.d[0]));
    e.R = fo_scale(1.0 + m->heat * t->place, m->R);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            e.slope[a][b] = fo_constant(t->h * m->loss * about.by_current[a][b]);
            if (a == b) e.slope[a][b] = fo_axpy(e.slope[a][b], t->h, e.R);
        }
    const fo_dual hR = fo_scale(t->h, e.R);
    fo_dual by_flux[2][2], X[2][2], both[2][2], square[2][2], whole[2][2];
    memcpy(by_flux, t->at->by_flux, sizeof by_flux);
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
    currents_of(t, &e);
    e.sign = fo_signs_of(m, e.middle.a.d[0], e.middle.b.d[0]);
    return e;
}

/* A cage in an interval of the course: its flux follows ψ' = R_R (i_d − ψ/L_M), and turns faster than
 * the rotor by the slip R_R i_q/ψ. */
typedef struct {
    double psi, rate;       /* [Wb]; R_R h [Ω s] */
    fo_dual i_d, i_q;       /* mean currents */
    double by[2][COLUMNS];  /* of i_d and i_q, by the parameters of the means */
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
        for (int j = 0; j < COLUMNS; j++) {
            g.by[0][j] += c * p->by[A][j] + s * p->by[B][j];
            g.by[1][j] += c * p->by[B][j] - s * p->by[A][j];
        }
    }
    /* The voltage is constant in stator coordinates, so the current bends in rotor coordinates: with
     * Δλ = h λ̇, h² i'' = (−2 j h ω e^{−jθ} Δλ − (h ω)² e^{−jθ} λ)/L_σ; a twelfth of it is missing. */
    const double turn = t->to->angle - t->from->angle, middle = 0.5 * (angles[0] + angles[1]);
    const double c = cos(middle), s = sin(middle), share = 1.0 / (12.0 * m->scale[0].d[0]);
    const double *x = t->from->flux, *y = t->to->flux;
    const double step[2] = {c * (y[A] - x[A]) + s * (y[B] - x[B]),
                            c * (y[B] - x[B]) - s * (y[A] - x[A])};
    const double mean[2] = {0.5 * (c * (x[A] + y[A]) + s * (x[B] + y[B])),
                            0.5 * (c * (x[B] + y[B]) - s * (x[A] + y[A]))};
    g.i_d.d[0] -= share * turn * (2.0 * step[1] - turn * mean[0]);
    g.i_q.d[0] -= share * turn * (-2.0 * step[0] - turn * mean[1]);
    const int iron = FO_L_iron_loss - FO_C; /* its current does not reach the rotor */
    g.by[0][iron] = g.by[1][iron] = 0.0;
    return g;
}

/* Flux after the interval, and its rows of the transition. `flux` and `angle`: deviations from the
 * course before it. */
static void move_flux(const fo_model *m, const interval *t, const electrical *e, const fo_dual flux[2],
                      const cage *g, fo_dual angle, fo_dual psi, state *x, transition *F)
{
    const double h = t->h;
    const fo_prediction *p = t->at;
    const double u[2] = {t->now[A] + m->lag * t->late[A], t->now[B] + m->lag * t->late[B]};
    /* How much more the angle turns than the course. */
    fo_dual step = fo_shift(t->from->angle - t->to->angle, fo_scale(h, x->x[FO_SPEED]));
    if (m->machine.cage) step = fo_axpy(step, g->rate / g->psi, g->i_q);
    fo_dual r[2], by_angle[2], by_psi[2], by_step[2], late[2];
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
            r[a].d[k] -= h * m->loss * (e->sign.by_current[a][A] * e->middle.a.d[k] +
                                        e->sign.by_current[a][B] * e->middle.b.d[k]);
        fo_product(&by_angle[a], &e->slope[a][A], &p->by_angle[A]);
        fo_accumulate(&by_angle[a], &e->slope[a][B], &p->by_angle[B]);
        fo_product(&by_psi[a], &e->slope[a][A], &p->by_psi[A]);
        fo_accumulate(&by_psi[a], &e->slope[a][B], &p->by_psi[B]);
        fo_product(&by_step[a], &e->slope[a][A], &late[A]);
        fo_accumulate(&by_step[a], &e->slope[a][B], &late[B]);
        fo_reduce(&r[a], &by_angle[a], &angle);
        fo_reduce(&r[a], &by_psi[a], &psi);
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
        put(F, fo_scale(-1.0, fo_mac(fo_mul(M[A], by_psi[A]), M[B], by_psi[B])));
        put(F, fo_scale(-h, M[A]));
        put(F, fo_scale(-h, M[B]));
        fo_dual moved = fo_shift(t->to->flux[a], fo_mul(M[A], r[A]));
        fo_accumulate(&moved, &M[B], &r[B]);
        x->x[FO_FLUX + a] = moved;
    }
}

/* Derivatives of a current in rotor coordinates by flux α and β, angle and ψ. */
enum { BY_ALPHA, BY_BETA, BY_ANGLE, BY_PSI, BY };

static void rotor_derivatives(const fo_prediction *p, double angle, fo_dual d[BY], fo_dual q[BY])
{
    const double c = cos(angle), s = sin(angle);
    const fo_dual *alpha[BY] = {&p->by_flux[A][A], &p->by_flux[A][B], &p->by_angle[A], &p->by_psi[A]};
    const fo_dual *beta[BY] = {&p->by_flux[B][A], &p->by_flux[B][B], &p->by_angle[B], &p->by_psi[B]};
    for (int k = 0; k < BY; k++) {
        d[k] = fo_axpy(fo_scale(c, *alpha[k]), s, *beta[k]);
        q[k] = fo_axpy(fo_scale(c, *beta[k]), -s, *alpha[k]);
    }
    const fo_dual i_d = fo_axpy(fo_scale(c, p->current.a), s, p->current.b);
    const fo_dual i_q = fo_axpy(fo_scale(c, p->current.b), -s, p->current.a);
    d[BY_ANGLE] = fo_add(d[BY_ANGLE], i_q);
    q[BY_ANGLE] = fo_sub(q[BY_ANGLE], i_d);
}

/* Angle, speed and ψ after the interval, with their rows of the transition: the torque is 3/2 n_p times
 * flux × current. */
static void move_rotor(const fo_model *m, const interval *t, const cage *g, const fo_dual flux[2],
                       fo_dual angle, fo_dual psi, state *x, transition *F)
{
    const double h = t->h, *course = t->from->flux;
    const fo_prediction *p = t->at;
    const fo_dual torque = fo_axpy(fo_scale(course[A], p->current.b), -course[B], p->current.a);
    const fo_dual mobility = fo_scale(h, m->mobility);
    const fo_dual *deviations[BY] = {&flux[A], &flux[B], &angle, &psi};
    const fo_dual by[BY] = {
        fo_mul(mobility, fo_add(fo_axpy(fo_scale(course[A], p->by_flux[B][A]), -course[B],
                                        p->by_flux[A][A]), p->current.b)),
        fo_mul(mobility, fo_sub(fo_axpy(fo_scale(course[A], p->by_flux[B][B]), -course[B],
                                        p->by_flux[A][B]), p->current.a)),
        fo_mul(mobility, fo_axpy(fo_scale(course[A], p->by_angle[B]), -course[B], p->by_angle[A])),
        fo_mul(mobility, fo_axpy(fo_scale(course[A], p->by_psi[B]), -course[B], p->by_psi[A]))};
    fo_dual d[BY], q[BY], slip = fo_constant(0.0);
    put_constant(F, h);
    put_constant(F, 0.5 * h * h);
    if (m->machine.cage) {
        const double over = g->rate / g->psi;
        rotor_derivatives(p, t->from->angle, d, q);
        slip = fo_scale(over, g->i_q);
        q[BY_PSI].d[0] -= g->i_q.d[0] / g->psi;
        for (int k = 0; k < BY; k++) {
            q[k] = fo_scale(over, q[k]);
            d[k] = fo_scale(g->rate, d[k]);
            fo_accumulate(&slip, &q[k], deviations[k]);
        }
        q[BY_ANGLE].d[0] += 1.0;
        d[BY_PSI].d[0] += 1.0 - g->rate * m->over_L_M;
        fo_dual moved = fo_shift(-g->rate * m->over_L_M * g->psi + t->from->psi,
                                 fo_scale(g->rate, g->i_d));
        for (int k = 0; k < BY; k++) fo_accumulate(&moved, &d[k], deviations[k]);
        x->x[FO_PSI] = moved;
        for (int k = 0; k < BY; k++) put(F, q[k]);
    } else {
        put_nothing(F, 2);
        put_constant(F, 1.0);
        put_nothing(F, 1);
    }
    for (int k = 0; k < BY; k++) put(F, by[k]);
    put_constant(F, 1.0);
    put_constant(F, h);
    if (m->machine.cage) {
        for (int k = 0; k < BY; k++) put(F, d[k]);
    } else {
        put_nothing(F, 3);
        put_constant(F, 1.0);
    }
    fo_dual speed = fo_axpy(fo_mul(mobility, torque), h, x->x[FO_ACCELERATION]);
    x->x[FO_ANGLE] = fo_axpy(fo_axpy(x->x[FO_ANGLE], h, x->x[FO_SPEED]), 0.5 * h, speed);
    x->x[FO_ANGLE] = fo_add(x->x[FO_ANGLE], slip);
    for (int k = 0; k < BY; k++) fo_accumulate(&speed, &by[k], deviations[k]);
    x->x[FO_SPEED] = fo_add(x->x[FO_SPEED], speed);
}

/* Predictable part of the noise after the interval. */
static void move_noise(const fo_model *m, const measurement *H, state *x, transition *F)
{
    const fo_dual colour = x->measured ? m->colour : fo_constant(0.0);
    const fo_dual memory = fo_sub(m->pole, colour);
    for (int a = 0; a < 2; a++) {
        fo_dual n = fo_mul(m->pole, x->x[FO_NOISE + a]);
        fo_accumulate(&n, &m->colour, a ? &x->residual.b : &x->residual.a);
        x->x[FO_NOISE + a] = n;
        put(F, memory);
        for (int b = 0; b < 2; b++) put(F, fo_scale(-1.0, fo_mul(colour, H->by_flux[a][b])));
        put(F, fo_scale(-1.0, fo_mul(colour, H->by_angle[a])));
        put(F, fo_scale(-1.0, fo_mul(colour, H->by_psi[a])));
    }
}

/* Derivatives by the parameters of the means: F x, and what they change themselves. */
static void move_sensitivity(const fo_model *m, const interval *t, const electrical *e,
                             const cage *g, const transition *F, double colour, sensitivity by)
{
    const double h = t->h, turning = h * m->mobility.d[0], *course = t->from->flux;
    const fo_prediction *p = t->at;
    sensitivity next;
    memset(next, 0, sizeof next);
    for (int k = 0; k < F->count; k++) {
        if (F->at[k].kind == ABSENT) continue;
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
    if (m->machine.cage) {
        const double decay = g->rate * m->over_L_M * g->psi;
        for (int j = 0; j < COLUMNS; j++) {
            next[FO_PSI][j] += g->rate * g->by[0][j];
            next[FO_ANGLE][j] += g->rate / g->psi * g->by[1][j];
        }
        next[FO_PSI][FO_L_rotor_resistance - FO_C] += g->rate * g->i_d.d[0] - decay;
        next[FO_ANGLE][FO_L_rotor_resistance - FO_C] += g->rate / g->psi * g->i_q.d[0];
        next[FO_PSI][FO_L_magnetizing - FO_C] += decay;
    }
    for (int a = 0; a < 2; a++) {
        r[a][FO_L_heat - FO_C] -= h * t->place * m->R.d[0] * (a ? e->mean.b : e->mean.a).d[0];
        r[a][FO_L_loss - FO_C] -= h * m->loss * e->sign.value[a];
        r[a][FO_L_knee - FO_C] -= h * m->loss * e->sign.by_knee[a];
        r[a][FO_L_lag - FO_C] += h * t->late[a];
        r[a][FO_L_delay - FO_C] += h * t->late[a];
    }
    for (int a = 0; a < 2; a++)
        for (int j = 0; j < COLUMNS; j++)
            next[FO_FLUX + a][j] += e->M[a][A].d[0] * r[A][j] + e->M[a][B].d[0] * r[B][j];
    memcpy(by, next, sizeof next);
}

/* Time update over an interval. */
static void advance(const fo_model *m, const interval *t, state *x, transition *F, sensitivity by)
{
    const electrical e = electrical_of(m, t);
    const fo_dual flux[2] = {fo_shift(-t->from->flux[A], x->x[FO_FLUX]),
                             fo_shift(-t->from->flux[B], x->x[FO_FLUX + 1])};
    const fo_dual angle = fo_shift(-t->from->angle, x->x[FO_ANGLE]);
    const fo_dual psi = fo_shift(-t->from->psi, x->x[FO_PSI]);
    cage g;
    if (m->machine.cage) g = cage_of(m, t);
    F->count = 0;
    move_flux(m, t, &e, flux, &g, angle, psi, x, F);
    move_rotor(m, t, &g, flux, angle, psi, x, F);
    for (int k = FO_ACCELERATION; k < FO_NOISE; k++) put_constant(F, 1.0);
    const double colour = x->measured ? m->colour.d[0] : 0.0;
    if (x->states > FO_WHITE) move_noise(m, t->sensed, x, F);
    move_sensitivity(m, t, &e, &g, F, colour, by);
    move_covariance(F, x);
    const double passed = fabs(t->h);
    for (int a = 0; a < 2; a++) {
        fo_accumulate_scaled(&x->P[FO_FLUX + a][FO_FLUX + a], passed, &m->voltage);
        fo_accumulate_scaled(&x->P[FO_DRIFT + a][FO_DRIFT + a], passed, &m->drift);
    }
    x->P[FO_PSI][FO_PSI].d[0] += passed * m->machine.psi_rate * m->machine.psi_rate;
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
static void keep_row(const state *x, const measurement *H, const update *z, sensitivity by_means,
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
        row->by_angle[a] = H->by_angle[a].d[0];
        row->by_psi[a] = H->by_psi[a].d[0];
        for (int b = 0; b < 2; b++) row->by_flux[2 * a + b] = H->by_flux[a][b].d[0];
        for (int r = 0; r < x->states; r++) row->K[r][a] = z->K[r][a].d[0];
    }
    const int at[3][2] = {{0, 0}, {0, 1}, {1, 1}};
    for (int n = 0; n < 3; n++) {
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

bool fo_innovations(const fo_log *log, const fo_machine *machine, const fo_course *course,
                    const double parameters[FO_UNKNOWNS], const fo_start *start,
                    fo_likelihood *out, fo_row *kept)
{
    const fo_model m = fo_model_of(machine, parameters);
    const double h = log->sample_time;
    state x;
    update z;
    transition F;
    sensitivity by_means;
    fo_prediction at, next;
    const double none[2] = {0.0, 0.0};
    double error_by[2][FO_UNKNOWNS], held[2] = {0.0, 0.0}, before[2];
    memset(out, 0, sizeof *out);
    const double speed = log->rows > 1 ? (course[1].angle - course[0].angle) / h : 0.0;
    start_at(&m, course, start, speed, &x, by_means);
    fo_predict(&m, course, speed, none, &at);
    for (size_t k = 0; k < log->rows; k++) {
        const double *i = log->current + 2 * k, *u = log->voltage + 2 * k;
        const bool known = isfinite(u[0]) && isfinite(u[1]);
        const measurement H = measurement_of(&at);
        memcpy(before, held, sizeof before);
        if (known) memcpy(held, u, sizeof held);
        if (k == 0) memcpy(before, held, sizeof before);
        if (isfinite(i[0]) && isfinite(i[1])) {
            if (!measure(&m, i, course + k, &at, &H, &x, &z)) return false;
            error_derivatives(&at, &H, &z, x.states, by_means, error_by);
            if (k >= start->skipped) count(&z, error_by, out);
        }
        if (!isfinite(x.x[FO_ANGLE].d[0])) return false;
        if (kept) keep_row(&x, &H, &z, by_means, error_by, kept + k);
        if (k + 1 == log->rows) break;
        const double turning = (course[k + 1].angle - course[k].angle) / h;
        fo_predict(&m, course + k + 1, turning, at.rotor, &next);
        /* A late voltage mixes with that of the row before, an early one with the next. */
        const double *v = u + 2;
        const double *after = isfinite(v[0]) && isfinite(v[1]) ? v : held;
        const double late[2] = {m.lag < 0.0 ? held[0] - after[0] : before[0] - held[0],
                                m.lag < 0.0 ? held[1] - after[1] : before[1] - held[1]};
        const interval t = {h, {held[0], held[1]}, {late[0], late[1]},
                            (double)k / (double)log->rows,
                            course + k, course + k + 1, &at, &next, &H};
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
