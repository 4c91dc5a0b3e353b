#include "innovations.h"

#include <math.h>
#include <string.h>

#include "dual.h"

typedef struct {
    fo_dual R, inverse_d, inverse_q, L_d, L_q, psi, loss, inverse_knee, mobility, lag, pole, colour;
    fo_dual noise, acceleration, voltage, drift, gain; /* variances */
    const double *harmonics;                            /* two coefficients of each order */
    bool has_harmonics;
} model;

typedef struct {
    fo_pair flux, drift, noise; /* stator coordinates; the noise's predictable part */
    fo_pair residual;           /* of the last measurement, after its update */
    bool measured;
    fo_dual angle, speed, acceleration, gain;
    fo_dual P[FO_STATES][FO_STATES];
} state;

/* What the measurement of the current depends on, at an angle. */
typedef struct {
    fo_pair unit;        /* e^{jθ} */
    fo_pair powers[3];   /* e^{2jθ}, e^{4jθ}, e^{6jθ} */
    fo_pair harmonics;   /* flux of the harmonics, rotor coordinates */
    fo_pair slope;       /* its derivative by the angle */
    fo_pair flux, current; /* rotor coordinates; the predicted current */
    fo_dual by_angle[2]; /* derivative of the current in stator coordinates, seen by the rotor */
} prediction;

/* A measurement update. */
typedef struct {
    fo_dual e[2], V[2][2], w[2], K[FO_STATES][2]; /* V: inverse of the covariance; w = V e */
    fo_dual S[2][2], det;
    prediction at;
} update;

/* Nonzero elements of the transition of the errors. */
typedef struct {
    unsigned char row, column;
    bool constant; /* its derivatives are zero */
    fo_dual value;
} element;

typedef struct {
    element at[40];
    int count;
} transition;

/* Derivatives of the errors' means by the coefficients of the harmonics and by the first angle, with
 * the gain held. */
enum { COLUMNS = FO_UNKNOWNS - FO_L };
typedef double sensitivity[FO_STATES][COLUMNS];

#define FO_LIST(order) order,
static const int orders[FO_ORDERS] = {FO_HARMONICS(FO_LIST)};
#undef FO_LIST

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
    m.L_d = positive(p, FO_L_L_d);
    m.L_q = positive(p, FO_L_L_q);
    m.inverse_d = fo_inverse(m.L_d);
    m.inverse_q = fo_inverse(m.L_q);
    m.psi = positive(p, FO_L_psi_f);
    m.loss = fo_unknown(p[FO_L_loss], FO_L_loss);
    m.inverse_knee = fo_inverse(positive(p, FO_L_knee));
    m.mobility = fo_unknown(p[FO_L_mobility], FO_L_mobility);
    m.lag = fo_unknown(p[FO_L_lag], FO_L_lag);
    m.pole = fo_unknown(p[FO_L_colour_pole], FO_L_colour_pole);
    m.colour = fo_unknown(p[FO_L_colour_gain], FO_L_colour_gain);
    m.noise = variance(p[FO_L_noise], FO_L_noise);
    m.acceleration = variance(p[FO_L_acceleration], FO_L_acceleration);
    m.voltage = variance(p[FO_L_voltage], FO_L_voltage);
    m.drift = variance(p[FO_L_drift], FO_L_drift);
    m.gain = variance(p[FO_L_gain], FO_L_gain);
    m.harmonics = p + FO_L;
    m.has_harmonics = false;
    for (int k = 0; k < 2 * FO_ORDERS; k++) m.has_harmonics |= m.harmonics[k] != 0.0;
    return m;
}

/* e^{jhθ}; h is 1 or even. */
static fo_pair power(const prediction *p, int order)
{
    const int count = order < 0 ? -order : order;
    fo_pair r = count == 1 ? p->unit : p->powers[count / 2 - 1];
    if (order < 0) r.b = fo_scale(-1.0, r.b);
    return r;
}

/* Σ a e^{jhθ} and its derivative by θ. */
static void harmonics_at(const model *m, prediction *p)
{
    p->harmonics = p->slope = fo_constant_pair(0.0, 0.0);
    if (!m->has_harmonics) return;
    for (int n = 0; n < FO_ORDERS; n++) {
        const double a = m->harmonics[2 * n], b = m->harmonics[2 * n + 1], h = orders[n];
        const fo_pair unit = power(p, orders[n]);
        const fo_pair x = {fo_axpy(fo_scale(a, unit.a), -b, unit.b),
                           fo_axpy(fo_scale(b, unit.a), a, unit.b)};
        const fo_pair turned = {fo_scale(-1.0, x.b), x.a};
        p->harmonics = fo_added(p->harmonics, 1.0, x);
        p->slope = fo_added(p->slope, h, turned);
    }
}

/* i = L⁻¹(λ_dq − ψ − harmonics). If the estimated rotor turns by δ, λ_dq turns by −δ and e^{jθ} by
 * δ: ∂i/∂θ = J i − L⁻¹ (J λ_dq + ∂harmonics/∂θ). */
static void current_at(const model *m, fo_pair flux, prediction *p)
{
    const fo_pair in_rotor = p->flux = fo_turned_back(flux, p->unit);
    p->current.a =
        fo_mul(fo_sub(fo_sub(in_rotor.a, m->psi), p->harmonics.a), m->inverse_d);
    p->current.b = fo_mul(fo_sub(in_rotor.b, p->harmonics.b), m->inverse_q);
    p->by_angle[0] = fo_sub(fo_mul(fo_sub(in_rotor.b, p->slope.a), m->inverse_d), p->current.b);
    p->by_angle[1] = fo_msub(p->current.a, fo_add(in_rotor.a, p->slope.b), m->inverse_q);
}

static prediction predict(const model *m, fo_pair flux, fo_dual angle)
{
    prediction p;
    p.unit = fo_unit(angle);
    p.powers[0] = fo_turned(p.unit, p.unit);
    p.powers[1] = fo_turned(p.powers[0], p.powers[0]);
    p.powers[2] = fo_turned(p.powers[1], p.powers[0]);
    harmonics_at(m, &p);
    current_at(m, flux, &p);
    return p;
}

/* Sum of the phases' smoothed signs as a vector, amplitude-invariant. */
static fo_pair signs(fo_pair i, fo_dual inverse_knee)
{
    const double half = 0.5, root = 0.86602540378443864676;
    const fo_dual a = fo_tanh_of(fo_mul(inverse_knee, i.a));
    const fo_dual b =
        fo_tanh_of(fo_mul(inverse_knee, fo_axpy(fo_scale(-half, i.a), root, i.b)));
    const fo_dual c =
        fo_tanh_of(fo_mul(inverse_knee, fo_axpy(fo_scale(-half, i.a), -root, i.b)));
    const fo_pair sum = {fo_scale(2.0 / 3.0, fo_sub(a, fo_scale(half, fo_add(b, c)))),
                         fo_scale(2.0 / 3.0 * root, fo_sub(b, c))};
    return sum;
}

/* u − v − R i − loss: the derivative of the flux. */
static fo_pair emf(const model *m, const state *x, fo_pair voltage, fo_pair current)
{
    const fo_pair sign = signs(current, m->inverse_knee);
    fo_pair u = fo_added(voltage, -1.0, x->drift);
    u.a = fo_msub(fo_msub(u.a, m->R, current.a), m->loss, sign.a);
    u.b = fo_msub(fo_msub(u.b, m->R, current.b), m->loss, sign.b);
    return u;
}

/* Flux × current; the torque is 3/2 n_p times it. */
static fo_dual torque(fo_pair flux, fo_pair current)
{
    return fo_msub(fo_mul(flux.a, current.b), flux.b, current.a);
}

static void start_at(const fo_log *log, const model *m, const fo_start *start, state *x,
                     sensitivity by_held)
{
    x->angle = fo_constant(start->angle);
    x->speed = fo_constant(start->speed);
    x->gain = fo_constant(0.0);
    x->drift = x->noise = x->residual = fo_constant_pair(0.0, 0.0);
    x->measured = false;
    const fo_pair unit = fo_unit(x->angle);
    const double *i = log->current;
    const bool known = isfinite(i[0]) && isfinite(i[1]);
    const fo_pair current =
        fo_turned_back(fo_constant_pair(known ? i[0] : 0.0, known ? i[1] : 0.0), unit);
    const fo_pair flux = {fo_mac(m->psi, m->L_d, current.a), fo_mul(m->L_q, current.b)};
    x->flux = fo_turned(flux, unit);
    /* The load balances the torque. */
    x->acceleration = fo_scale(-1.0, fo_mul(m->mobility, torque(flux, current)));
    const double stds[FO_NOISE_D] = {start->flux_std,         start->flux_std, start->angle_std,
                                     start->speed_std,        start->acceleration_std,
                                     start->gain_std,         start->drift_std,
                                     start->drift_std};
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < FO_STATES; c++)
            x->P[r][c] = fo_constant(r == c && r < FO_NOISE_D ? stds[r] * stds[r] : 0.0);
    x->P[FO_NOISE_D][FO_NOISE_D] = x->P[FO_NOISE_Q][FO_NOISE_Q] =
        fo_mul(fo_mul(m->colour, m->colour), m->noise);
    /* If the rotor turns and the current does not: ∂λ/∂θ = J λ − L J i. */
    memset(by_held, 0, sizeof(sensitivity));
    by_held[FO_ANGLE][FO_TURN - FO_L] = 1.0;
    by_held[FO_FLUX_D][FO_TURN - FO_L] = m->L_d.d[0] * current.b.d[0] - flux.b.d[0];
    by_held[FO_FLUX_Q][FO_TURN - FO_L] = flux.a.d[0] - m->L_q.d[0] * current.a.d[0];
}

/* Element (a, b) of H P Hᵀ, from P Hᵀ. */
static fo_dual observed(const model *m, const prediction *p, fo_dual PH[FO_STATES][2], int a,
                        int b)
{
    const fo_dual inverse = a ? m->inverse_q : m->inverse_d;
    const fo_dual by_flux = fo_mac(PH[FO_NOISE_D + a][b], inverse, PH[FO_FLUX_D + a][b]);
    return fo_mac(by_flux, p->by_angle[a], PH[FO_ANGLE][b]);
}

/* Innovation of a row. */
static void innovation(const model *m, const double measured[2], const state *x, update *z)
{
    z->at = predict(m, x->flux, x->angle);
    const fo_pair y = fo_turned_back(fo_constant_pair(measured[0], measured[1]), z->at.unit);
    const fo_pair coloured = fo_turned_back(x->noise, z->at.unit);
    z->e[0] = fo_sub(fo_sub(y.a, z->at.current.a), coloured.a);
    z->e[1] = fo_sub(fo_sub(y.b, z->at.current.b), coloured.b);
}

/* Adds a correction of the errors to the state. */
static void correct(const model *m, const update *z, const fo_dual change[FO_STATES], state *x)
{
    const fo_pair flux = {change[FO_FLUX_D], change[FO_FLUX_Q]},
                  drift = {change[FO_DRIFT_D], change[FO_DRIFT_Q]},
                  noise = {change[FO_NOISE_D], change[FO_NOISE_Q]},
                  residual = {fo_mul(m->noise, z->w[0]), fo_mul(m->noise, z->w[1])};
    x->flux = fo_added(x->flux, 1.0, fo_turned(flux, z->at.unit));
    x->drift = fo_added(x->drift, 1.0, fo_turned(drift, z->at.unit));
    x->noise = fo_added(x->noise, 1.0, fo_turned(noise, z->at.unit));
    x->residual = fo_turned(residual, z->at.unit);
    x->measured = true;
    x->angle = fo_add(x->angle, change[FO_ANGLE]);
    x->speed = fo_add(x->speed, change[FO_SPEED]);
    x->acceleration = fo_add(x->acceleration, change[FO_ACCELERATION]);
    x->gain = fo_add(x->gain, change[FO_GAIN]);
}

/* Measurement update. */
static bool measure(const model *m, const double measured[2], state *x, update *z)
{
    innovation(m, measured, x, z);
    const prediction *p = &z->at;
    fo_dual PH[FO_STATES][2];
    for (int r = 0; r < FO_STATES; r++) {
        const fo_dual *P = x->P[r];
        PH[r][0] = fo_mac(fo_mac(P[FO_NOISE_D], P[FO_FLUX_D], m->inverse_d), P[FO_ANGLE],
                          p->by_angle[0]);
        PH[r][1] = fo_mac(fo_mac(P[FO_NOISE_Q], P[FO_FLUX_Q], m->inverse_q), P[FO_ANGLE],
                          p->by_angle[1]);
    }
    z->S[0][0] = fo_add(m->noise, observed(m, p, PH, 0, 0));
    z->S[1][0] = z->S[0][1] = observed(m, p, PH, 0, 1);
    z->S[1][1] = fo_add(m->noise, observed(m, p, PH, 1, 1));
    z->det = fo_msub(fo_mul(z->S[0][0], z->S[1][1]), z->S[0][1], z->S[0][1]);
    if (!(z->det.d[0] > 0.0) || !isfinite(z->det.d[0]) || !isfinite(z->e[0].d[0])) return false;
    const fo_dual inverse = fo_inverse(z->det);
    z->V[0][0] = fo_mul(z->S[1][1], inverse);
    z->V[0][1] = z->V[1][0] = fo_scale(-1.0, fo_mul(z->S[0][1], inverse));
    z->V[1][1] = fo_mul(z->S[0][0], inverse);
    for (int a = 0; a < 2; a++)
        z->w[a] = fo_mac(fo_mul(z->V[a][0], z->e[0]), z->V[a][1], z->e[1]);
    fo_dual change[FO_STATES];
    for (int r = 0; r < FO_STATES; r++) {
        change[r] = fo_mac(fo_mul(PH[r][0], z->w[0]), PH[r][1], z->w[1]);
        for (int a = 0; a < 2; a++)
            z->K[r][a] = fo_mac(fo_mul(PH[r][0], z->V[0][a]), PH[r][1], z->V[1][a]);
        for (int c = r; c < FO_STATES; c++) {
            fo_reduce(&x->P[r][c], &z->K[r][0], &PH[c][0]);
            fo_reduce(&x->P[r][c], &z->K[r][1], &PH[c][1]);
            x->P[c][r] = x->P[r][c];
        }
    }
    correct(m, z, change, x);
    return true;
}

/* ∂i_dq/∂a of the coefficients: −L⁻¹ e^{jhθ}, in both components. */
static void current_by_harmonics(const model *m, const prediction *p, double by[2][COLUMNS])
{
    const double inverse_d = m->inverse_d.d[0], inverse_q = m->inverse_q.d[0];
    by[0][FO_TURN - FO_L] = by[1][FO_TURN - FO_L] = 0.0;
    for (int n = 0; n < FO_ORDERS; n++) {
        const fo_pair unit = power(p, orders[n]);
        by[0][2 * n] = -inverse_d * unit.a.d[0];
        by[1][2 * n] = -inverse_q * unit.b.d[0];
        by[0][2 * n + 1] = inverse_d * unit.b.d[0];
        by[1][2 * n + 1] = -inverse_q * unit.a.d[0];
    }
}

/* Derivatives of the innovation e = y − H x − i by all parameters; those by the harmonics hold the
 * gain. */
static void error_derivatives(const model *m, const update *z, sensitivity x,
                              double by[2][FO_UNKNOWNS])
{
    double current[2][COLUMNS];
    current_by_harmonics(m, &z->at, current);
    for (int a = 0; a < 2; a++) {
        const double inverse = (a ? m->inverse_q : m->inverse_d).d[0];
        const double by_angle = z->at.by_angle[a].d[0];
        const double *flux = x[FO_FLUX_D + a], *noise = x[FO_NOISE_D + a], *angle = x[FO_ANGLE];
        for (int k = 0; k < FO_L; k++) by[a][k] = z->e[a].d[k + 1];
        for (int k = 0; k < COLUMNS; k++)
            by[a][FO_L + k] =
                -current[a][k] - inverse * flux[k] - by_angle * angle[k] - noise[k];
    }
}

/* Adds a row to the objective, the score and the information. */
static void count(const update *z, double by[2][FO_UNKNOWNS], fo_likelihood *out)
{
    const fo_dual square = fo_mac(fo_mul(z->e[0], z->w[0]), z->e[1], z->w[1]);
    const double inverse = 1.0 / z->det.d[0];
    out->objective += 0.5 * (square.d[0] + log(z->det.d[0]));
    out->mean_square += 0.5 * square.d[0];
    out->counted++;
    for (int k = 0; k < FO_L; k++)
        out->score[k] += 0.5 * (square.d[k + 1] + z->det.d[k + 1] * inverse);
    for (int k = FO_L; k < FO_UNKNOWNS; k++)
        out->score[k] += by[0][k] * z->w[0].d[0] + by[1][k] * z->w[1].d[0];
    for (int r = 0; r < FO_UNKNOWNS; r++) {
        const double a = z->V[0][0].d[0] * by[0][r] + z->V[0][1].d[0] * by[1][r];
        const double b = z->V[1][0].d[0] * by[0][r] + z->V[1][1].d[0] * by[1][r];
        double *row = out->information + r * FO_UNKNOWNS;
        for (int c = 0; c < FO_UNKNOWNS; c++) row[c] += a * by[0][c] + b * by[1][c];
    }
    /* ½ tr(S⁻¹ ∂S S⁻¹ ∂S) */
    double VS[2][2][FO_L];
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++)
            for (int k = 0; k < FO_L; k++)
                VS[a][b][k] = z->V[a][0].d[0] * z->S[0][b].d[k + 1] +
                              z->V[a][1].d[0] * z->S[1][b].d[k + 1];
    for (int r = 0; r < FO_L; r++)
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++)
                for (int c = 0; c < FO_L; c++)
                    out->information[r * FO_UNKNOWNS + c] += 0.5 * VS[a][b][r] * VS[b][a][c];
}

static void put(transition *F, int row, int column, fo_dual value)
{
    element *e = &F->at[F->count++];
    e->row = (unsigned char)row;
    e->column = (unsigned char)column;
    e->value = value;
    e->constant = true;
    for (int k = 1; k < FO_WIDTH; k++) e->constant &= value.d[k] == 0.0;
}

/* Two rows of the transition, turned back by the interval's angle, from a diagonal part. */
static void put_turned(transition *F, int row, int column, fo_pair diagonal, fo_pair turn)
{
    put(F, row, column, fo_mul(turn.a, diagonal.a));
    put(F, row, column + 1, fo_mul(turn.b, diagonal.b));
    put(F, row + 1, column, fo_scale(-1.0, fo_mul(turn.b, diagonal.a)));
    put(F, row + 1, column + 1, fo_mul(turn.a, diagonal.b));
}

static void put_vector(transition *F, int row, int column, fo_pair x)
{
    put(F, row, column, x.a);
    put(F, row + 1, column, x.b);
}

/* Time update of the derivatives by the harmonics: F x, and what the current itself changes. */
static void move_sensitivity(const transition *F, const model *m, const prediction *p,
                             const fo_pair *turn, double h, double colour, sensitivity x)
{
    double next[FO_STATES][COLUMNS] = {{0.0}}, current[2][COLUMNS];
    const double c = turn->a.d[0], s = turn->b.d[0];
    current_by_harmonics(m, p, current);
    for (int k = 0; k < F->count; k++) {
        const element *e = &F->at[k];
        for (int j = 0; j < COLUMNS; j++)
            next[e->row][j] += e->value.d[0] * x[e->column][j];
    }
    double drop[2];
    for (int a = 0; a < 2; a++) {
        const double decay = h * m->R.d[0] * (a ? m->inverse_q : m->inverse_d).d[0];
        drop[a] = h * m->R.d[0] * (1.0 - 0.5 * decay);
    }
    for (int j = 0; j < COLUMNS; j++) {
        const double i_d = current[0][j], i_q = current[1][j];
        next[FO_FLUX_D][j] -= c * drop[0] * i_d + s * drop[1] * i_q;
        next[FO_FLUX_Q][j] -= c * drop[1] * i_q - s * drop[0] * i_d;
        next[FO_NOISE_D][j] -= colour * (c * i_d + s * i_q);
        next[FO_NOISE_Q][j] -= colour * (c * i_q - s * i_d);
    }
    memcpy(x, next, sizeof next);
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
    for (int k = 0; k < F->count; k++) {
        const element *e = &F->at[k];
        for (int c = 0; c < FO_STATES; c++)
            apply(e, &x->P[e->column][c], &M[e->row][c], written[e->row]);
        written[e->row] = true;
    }
    memset(written, 0, sizeof written);
    for (int k = 0; k < F->count; k++) {
        const element *e = &F->at[k];
        for (int r = 0; r <= e->row; r++)
            apply(e, &M[r][e->column], &x->P[r][e->row], written[e->row]);
        written[e->row] = true;
    }
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < r; c++) x->P[r][c] = x->P[c][r];
}

/* The state after an interval of length h, with the voltage that the log states for it. `now`: the
 * prediction before it; `turn`: e^{jθ} of the interval. */
static void move_state(double h, const model *m, fo_pair voltage, state *x, transition *F,
                       prediction *before, fo_pair *turned)
{
    const prediction now = *before = predict(m, x->flux, x->angle);
    const fo_dual gain = fo_shift(1.0, x->gain);
    const fo_pair applied = {fo_mul(voltage.a, gain), fo_mul(voltage.b, gain)};
    /* Runge–Kutta: the current turns and decays within the interval; the harmonics are held. */
    static const double reach[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    const fo_pair half_turn = fo_unit(fo_scale(0.5 * h, x->speed));
    fo_pair slope = {fo_constant(0.0), fo_constant(0.0)}, sum = slope;
    prediction p = now;
    for (int stage = 0; stage < 4; stage++) {
        if (stage == 1 || stage == 3) p.unit = fo_turned(p.unit, half_turn);
        if (stage) current_at(m, fo_added(x->flux, reach[stage] * h, slope), &p);
        slope = emf(m, x, applied, fo_turned(p.current, p.unit));
        sum = fo_added(sum, weight[stage], slope);
    }
    x->flux = fo_added(x->flux, h / 6.0, sum);
    x->noise.a = fo_mac(fo_mul(m->pole, x->noise.a), m->colour, x->residual.a);
    x->noise.b = fo_mac(fo_mul(m->pole, x->noise.b), m->colour, x->residual.b);
    const fo_dual acceleration =
        fo_mac(x->acceleration, m->mobility, torque(now.flux, now.current));
    const fo_dual angle = fo_axpy(fo_scale(h, x->speed), 0.5 * h * h, acceleration);
    x->angle = fo_add(x->angle, angle);
    x->speed = fo_axpy(x->speed, h, acceleration);

    /* Errors: δλ⁺ = (1 − g) δλ − h R' ∂i/∂θ (δθ + h/2 δω) − h δv + h u δε; the mean current of the
     * interval has seen half of the decay. w of the row is the residual: its error is that of the
     * predicted current and noise. */
    const fo_dual one = fo_constant(1.0);
    const fo_dual colour = x->measured ? m->colour : fo_constant(0.0);
    const fo_pair turn = *turned = fo_unit(angle), in_rotor = fo_turned_back(voltage, now.unit);
    fo_pair keep, by_angle, by_flux, noise_by_angle;
    for (int a = 0; a < 2; a++) {
        const fo_dual inverse = a ? m->inverse_q : m->inverse_d;
        const fo_dual decay = fo_scale(h, fo_mul(m->R, inverse));
        const fo_dual mean = fo_shift(1.0, fo_scale(-0.5, decay));
        *(a ? &keep.b : &keep.a) = fo_shift(1.0, fo_scale(-1.0, fo_mul(decay, mean)));
        *(a ? &by_angle.b : &by_angle.a) =
            fo_scale(-h, fo_mul(fo_mul(m->R, mean), now.by_angle[a]));
        *(a ? &by_flux.b : &by_flux.a) = fo_scale(-1.0, fo_mul(colour, inverse));
        *(a ? &noise_by_angle.b : &noise_by_angle.a) =
            fo_scale(-1.0, fo_mul(colour, now.by_angle[a]));
    }
    const fo_dual memory = fo_sub(m->pole, colour);
    const fo_pair rotor = fo_turned_back(by_angle, turn);
    const fo_pair half = {fo_scale(0.5 * h, rotor.a), fo_scale(0.5 * h, rotor.b)};
    F->count = 0;
    put_turned(F, FO_FLUX_D, FO_FLUX_D, keep, turn);
    put_vector(F, FO_FLUX_D, FO_ANGLE, rotor);
    put_vector(F, FO_FLUX_D, FO_SPEED, half);
    put_vector(F, FO_FLUX_D, FO_GAIN,
               fo_turned_back((fo_pair){fo_scale(h, in_rotor.a), fo_scale(h, in_rotor.b)}, turn));
    put_turned(F, FO_FLUX_D, FO_DRIFT_D, fo_constant_pair(-h, -h), turn);
    put(F, FO_ANGLE, FO_ANGLE, one);
    put(F, FO_ANGLE, FO_SPEED, fo_constant(h));
    put(F, FO_ANGLE, FO_ACCELERATION, fo_constant(0.5 * h * h));
    const fo_dual by_d = fo_msub(now.current.b, now.flux.b, m->inverse_d);
    const fo_dual by_q = fo_sub(fo_mul(now.flux.a, m->inverse_q), now.current.a);
    const fo_dual by_turn =
        fo_msub(fo_mul(now.flux.a, now.by_angle[1]), now.flux.b, now.by_angle[0]);
    const fo_dual mobility = fo_scale(h, m->mobility);
    put(F, FO_SPEED, FO_FLUX_D, fo_mul(mobility, by_d));
    put(F, FO_SPEED, FO_FLUX_Q, fo_mul(mobility, by_q));
    put(F, FO_SPEED, FO_ANGLE, fo_mul(mobility, by_turn));
    put(F, FO_SPEED, FO_SPEED, one);
    put(F, FO_SPEED, FO_ACCELERATION, fo_constant(h));
    put(F, FO_ACCELERATION, FO_ACCELERATION, one);
    put(F, FO_GAIN, FO_GAIN, one);
    put_turned(F, FO_DRIFT_D, FO_DRIFT_D, fo_constant_pair(1.0, 1.0), turn);
    put_turned(F, FO_NOISE_D, FO_NOISE_D, (fo_pair){memory, memory}, turn);
    put_turned(F, FO_NOISE_D, FO_FLUX_D, by_flux, turn);
    put_vector(F, FO_NOISE_D, FO_ANGLE, fo_turned_back(noise_by_angle, turn));
}

/* Time update over an interval. */
static void advance(double h, const model *m, fo_pair voltage, state *x, transition *F,
                    sensitivity by_held)
{
    prediction now;
    fo_pair turn;
    const double colour = x->measured ? m->colour.d[0] : 0.0;
    move_state(h, m, voltage, x, F, &now, &turn);
    move_covariance(F, x);
    move_sensitivity(F, m, &now, &turn, h, colour, by_held);
    const double passed = fabs(h);
    for (int a = 0; a < 2; a++) {
        fo_dual *flux = &x->P[a][a], *drift = &x->P[FO_DRIFT_D + a][FO_DRIFT_D + a];
        *flux = fo_axpy(*flux, passed, m->voltage);
        *drift = fo_axpy(*drift, passed, m->drift);
    }
    fo_dual *walk = &x->P[FO_ACCELERATION][FO_ACCELERATION];
    *walk = fo_axpy(*walk, passed, m->acceleration);
    x->P[FO_GAIN][FO_GAIN] = fo_axpy(x->P[FO_GAIN][FO_GAIN], passed, m->gain);
    if (!x->measured) { /* w of this row is unknown */
        const fo_dual more = fo_mul(fo_mul(m->colour, m->colour), m->noise);
        for (int a = FO_NOISE_D; a <= FO_NOISE_Q; a++) x->P[a][a] = fo_add(x->P[a][a], more);
    }
    x->measured = false;
    x->residual = fo_constant_pair(0.0, 0.0);
}

/* The voltage of an interval, with the lag. */
static fo_pair late(const model *m, const double now[2], const double before[2])
{
    const fo_pair u = {fo_shift(now[0], fo_scale(before[0] - now[0], m->lag)),
                       fo_shift(now[1], fo_scale(before[1] - now[1], m->lag))};
    return u;
}

/* Removes the derivatives: what is known is the number. */
static void forget(fo_dual *x)
{
    for (int k = 1; k < FO_WIDTH; k++) x->d[k] = 0.0;
}

static void forget_all(state *x)
{
    fo_dual *const own[] = {&x->flux.a,  &x->flux.b,  &x->drift.a,    &x->drift.b,
                            &x->noise.a, &x->noise.b, &x->residual.a, &x->residual.b,
                            &x->angle,   &x->speed,   &x->acceleration, &x->gain};
    for (size_t k = 0; k < sizeof own / sizeof *own; k++) forget(own[k]);
}

/* The filter has lost the rotor where innovations stay far larger than their covariance says. Then
 * its covariance is that of a start again: it finds the rotor, and rows before and after a jump do
 * not spoil each other. */
enum { RECENT = 16 };
/* Mean of the last normalised squares. If all is right it is 1 with a standard deviation of 0.2. */
static const double lost = 8.0;

static double square_of(const update *z)
{
    return z->e[0].d[0] * z->w[0].d[0] + z->e[1].d[0] * z->w[1].d[0];
}

/* Of the running mean of the normalised squares. */
static bool is_lost(double square, double *recent)
{
    *recent += (0.5 * square - *recent) / (double)RECENT;
    if (*recent < lost) return false;
    *recent = 1.0;
    return true;
}

bool fo_is_lost(const fo_row *row, double *recent)
{
    const double *e = row->error;
    return is_lost(e[0] * (row->inverse[0][0] * e[0] + 2.0 * row->inverse[0][1] * e[1]) +
                       e[1] * row->inverse[1][1] * e[1],
                   recent);
}

static void start_again(const fo_start *start, state *x, sensitivity by_held)
{
    const double stds[FO_GAIN] = {start->flux_std, start->flux_std, start->angle_std,
                                  start->speed_std, start->acceleration_std};
    forget_all(x); /* derivatives of a filter that is lost grow without bound */
    memset(by_held, 0, sizeof(sensitivity));
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < FO_STATES; c++) forget(&x->P[r][c]);
    for (int k = 0; k < FO_GAIN; k++) x->P[k][k].d[0] += stds[k] * stds[k];
}

/* Keeps a row after its measurement update. */
static void keep_row(const model *m, const state *x, const update *z, sensitivity by_held,
                     double error_by[2][FO_UNKNOWNS], fo_row *row)
{
    memset(row, 0, sizeof *row);
    row->angle = x->angle.d[0];
    row->speed = x->speed.d[0];
    row->measured = x->measured;
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < FO_STATES; c++) row->P[r][c] = x->P[r][c].d[0];
    for (int k = 0; k < FO_UNKNOWNS; k++) {
        row->state_by[0][k] = k < FO_L ? x->angle.d[k + 1] : by_held[FO_ANGLE][k - FO_L];
        row->state_by[1][k] = k < FO_L ? x->speed.d[k + 1] : by_held[FO_SPEED][k - FO_L];
    }
    if (!x->measured) return;
    memcpy(row->error_by, error_by, sizeof row->error_by);
    for (int a = 0; a < 2; a++) {
        row->error[a] = z->e[a].d[0];
        row->H[a][FO_FLUX_D + a] = (a ? m->inverse_q : m->inverse_d).d[0];
        row->H[a][FO_ANGLE] = z->at.by_angle[a].d[0];
        row->H[a][FO_NOISE_D + a] = 1.0;
        for (int b = 0; b < 2; b++) row->inverse[a][b] = z->V[a][b].d[0];
        for (int r = 0; r < FO_STATES; r++) row->K[r][a] = z->K[r][a].d[0];
    }
}

bool fo_innovations(const fo_log *log, const double parameters[FO_UNKNOWNS], const fo_start *start,
                    fo_likelihood *out, fo_row *kept)
{
    const model m = model_of(parameters);
    state x;
    update z;
    transition F;
    sensitivity by_held;
    double error_by[2][FO_UNKNOWNS], recent = 1.0, held[2] = {0.0, 0.0}, before[2];
    memset(out, 0, sizeof *out);
    start_at(log, &m, start, &x, by_held);
    for (size_t k = 0; k < log->rows; k++) {
        const double *i = log->current + 2 * k, *u = log->voltage + 2 * k;
        const bool known = isfinite(u[0]) && isfinite(u[1]);
        memcpy(before, held, sizeof before);
        if (known) memcpy(held, u, sizeof held);
        if (k == 0) memcpy(before, held, sizeof before);
        if (isfinite(i[0]) && isfinite(i[1])) {
            if (!measure(&m, i, &x, &z)) return false;
            error_derivatives(&m, &z, by_held, error_by);
            if (k >= start->skipped) count(&z, error_by, out);
            if (start->price > 0.0 && is_lost(square_of(&z), &recent)) {
                start_again(start, &x, by_held);
                out->objective += start->price;
                out->losses++;
            }
            for (int r = 0; r < FO_STATES; r++)
                for (int j = 0; j < COLUMNS; j++)
                    by_held[r][j] += z.K[r][0].d[0] * error_by[0][FO_L + j] +
                                     z.K[r][1].d[0] * error_by[1][FO_L + j];
        }
        if (!isfinite(x.angle.d[0])) return false;
        if (kept) keep_row(&m, &x, &z, by_held, error_by, kept + k);
        advance(log->sample_time, &m, late(&m, held, before), &x, &F, by_held);
        if (!known) { /* held, and as uncertain as it is large */
            const double h = log->sample_time;
            const double variance_of = h * h * (held[0] * held[0] + held[1] * held[1]);
            for (int a = 0; a < 2; a++) x.P[a][a].d[0] += 0.5 * variance_of;
        }
        if (kept)
            for (int n = 0; n < F.count; n++)
                kept[k].F[F.at[n].row][F.at[n].column] = F.at[n].value.d[0];
    }
    if (out->counted) out->mean_square /= (double)out->counted;
    return true;
}
