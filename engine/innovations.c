#include "innovations.h"

#include <math.h>
#include <string.h>

#include "dual.h"

/* Errors of the state, in the coordinates of the estimated rotor: there the matrices of the filter
 * depend on the parameters, on the speed and on i_dq only, and change slowly. */
enum { FLUX_D, FLUX_Q, ANGLE, SPEED, DRIFT_D, DRIFT_Q, NOISE_D, NOISE_Q, STATES };

typedef struct {
    fo_dual R, L_d, L_q, inverse_d, inverse_q, psi, loss, lag, pole, gain;
    fo_dual noise, acceleration, voltage, drift; /* variances */
} model;

typedef struct {
    fo_pair flux, drift, noise; /* stator coordinates; the noise's predictable part */
    fo_pair residual;           /* of the last measurement, after its update */
    bool measured;
    fo_dual angle, speed;
    fo_dual P[STATES][STATES];
} state;

/* What the measurement of the current depends on, at an angle. */
typedef struct {
    fo_pair unit, current; /* e^{jθ}; predicted current in rotor coordinates */
    fo_dual by_angle[2];   /* derivative of the current in stator coordinates, seen by the rotor */
} prediction;

static fo_dual variance(double logarithm, int index)
{
    return fo_exp_of(fo_scale(2.0, fo_unknown(logarithm, index)));
}

static model model_of(const double p[FO_L])
{
    model m;
    m.R = fo_exp_of(fo_unknown(p[FO_L_resistance], FO_L_resistance));
    m.L_d = fo_exp_of(fo_unknown(p[FO_L_L_d], FO_L_L_d));
    m.L_q = fo_exp_of(fo_unknown(p[FO_L_L_q], FO_L_L_q));
    m.inverse_d = fo_inverse(m.L_d);
    m.inverse_q = fo_inverse(m.L_q);
    m.psi = fo_exp_of(fo_unknown(p[FO_L_psi_f], FO_L_psi_f));
    m.loss = fo_unknown(p[FO_L_loss], FO_L_loss);
    m.lag = fo_unknown(p[FO_L_lag], FO_L_lag);
    m.pole = fo_unknown(p[FO_L_colour_pole], FO_L_colour_pole);
    m.gain = fo_unknown(p[FO_L_colour_gain], FO_L_colour_gain);
    m.noise = variance(p[FO_L_noise], FO_L_noise);
    m.acceleration = variance(p[FO_L_acceleration], FO_L_acceleration);
    m.voltage = variance(p[FO_L_voltage], FO_L_voltage);
    m.drift = variance(p[FO_L_drift], FO_L_drift);
    return m;
}

/* i = L⁻¹(λ_dq − ψ). If the estimated rotor turns by δ, λ_dq turns by −δ and e^{jθ} by δ:
 * ∂i/∂θ = J i − L⁻¹ J λ_dq. */
static prediction predict(const model *m, fo_pair flux, fo_dual angle)
{
    prediction p;
    p.unit = fo_unit(angle);
    const fo_pair in_rotor = fo_turned_back(flux, p.unit);
    p.current.a = fo_mul(fo_sub(in_rotor.a, m->psi), m->inverse_d);
    p.current.b = fo_mul(in_rotor.b, m->inverse_q);
    p.by_angle[0] = fo_sub(fo_mul(in_rotor.b, m->inverse_d), p.current.b);
    p.by_angle[1] = fo_msub(p.current.a, in_rotor.a, m->inverse_q);
    return p;
}

/* Sum of the phases' smoothed signs as a vector, amplitude-invariant. */
static fo_pair signs(fo_pair i, double knee)
{
    const double half = 0.5, root = 0.86602540378443864676;
    const fo_dual a = fo_tanh_of(fo_scale(1.0 / knee, i.a));
    const fo_dual b = fo_tanh_of(fo_scale(1.0 / knee, fo_axpy(fo_scale(-half, i.a), root, i.b)));
    const fo_dual c = fo_tanh_of(fo_scale(1.0 / knee, fo_axpy(fo_scale(-half, i.a), -root, i.b)));
    const fo_pair sum = {fo_scale(2.0 / 3.0, fo_sub(a, fo_scale(half, fo_add(b, c)))),
                         fo_scale(2.0 / 3.0 * root, fo_sub(b, c))};
    return sum;
}

/* u − v − R i − loss: the derivative of the flux. */
static fo_pair emf(const model *m, const state *x, fo_pair voltage, fo_pair current, double knee)
{
    fo_pair u = fo_added(voltage, -1.0, x->drift);
    u.a = fo_msub(u.a, m->R, current.a);
    u.b = fo_msub(u.b, m->R, current.b);
    if (knee > 0.0) {
        const fo_pair sign = signs(current, knee);
        u.a = fo_msub(u.a, m->loss, sign.a);
        u.b = fo_msub(u.b, m->loss, sign.b);
    }
    return u;
}

static void start_at(const fo_log *log, const model *m, const fo_start *start, state *x)
{
    x->angle = fo_constant(start->angle);
    x->speed = fo_constant(start->speed);
    x->drift = x->noise = x->residual = fo_constant_pair(0.0, 0.0);
    x->measured = false;
    const fo_pair unit = fo_unit(x->angle);
    const double *i = log->current;
    const bool known = isfinite(i[0]) && isfinite(i[1]);
    fo_pair in_rotor =
        fo_turned_back(fo_constant_pair(known ? i[0] : 0.0, known ? i[1] : 0.0), unit);
    in_rotor.a = fo_mac(m->psi, m->L_d, in_rotor.a);
    in_rotor.b = fo_mul(m->L_q, in_rotor.b);
    x->flux = fo_turned(in_rotor, unit);
    for (int r = 0; r < STATES; r++)
        for (int c = 0; c < STATES; c++) x->P[r][c] = fo_constant(0.0);
    const double stds[NOISE_D] = {start->flux_std,  start->flux_std,  start->angle_std,
                                  start->speed_std, start->drift_std, start->drift_std};
    for (int r = 0; r < NOISE_D; r++) x->P[r][r].v = stds[r] * stds[r];
    x->P[NOISE_D][NOISE_D] = x->P[NOISE_Q][NOISE_Q] = fo_mul(fo_mul(m->gain, m->gain), m->noise);
}

/* Adds the information of a component with these derivatives. */
static void add_information(double weight, const double *a, const double *b, double *information)
{
    for (int r = 0; r < FO_L; r++)
        for (int c = 0; c < FO_L; c++) information[r * FO_L + c] += weight * a[r] * b[c];
}

/* Element (a, b) of H P Hᵀ, from P Hᵀ. */
static fo_dual observed(const model *m, const prediction *p, fo_dual PH[STATES][2], int a, int b)
{
    const fo_dual inverse = a ? m->inverse_q : m->inverse_d;
    const fo_dual by_flux = fo_mac(PH[NOISE_D + a][b], inverse, PH[FLUX_D + a][b]);
    return fo_mac(by_flux, p->by_angle[a], PH[ANGLE][b]);
}

/* Measurement update; adds to the likelihood if the row counts. */
static bool measure(const model *m, const double measured[2], bool counts, state *x,
                    fo_likelihood *out)
{
    const prediction p = predict(m, x->flux, x->angle);
    const fo_pair y = fo_turned_back(fo_constant_pair(measured[0], measured[1]), p.unit);
    const fo_pair coloured = fo_turned_back(x->noise, p.unit);
    const fo_dual e[2] = {fo_sub(fo_sub(y.a, p.current.a), coloured.a),
                          fo_sub(fo_sub(y.b, p.current.b), coloured.b)};
    fo_dual PH[STATES][2], S[2][2];
    for (int r = 0; r < STATES; r++) {
        PH[r][0] = fo_mac(fo_mac(x->P[r][NOISE_D], x->P[r][FLUX_D], m->inverse_d), x->P[r][ANGLE],
                          p.by_angle[0]);
        PH[r][1] = fo_mac(fo_mac(x->P[r][NOISE_Q], x->P[r][FLUX_Q], m->inverse_q), x->P[r][ANGLE],
                          p.by_angle[1]);
    }
    S[0][0] = fo_add(m->noise, observed(m, &p, PH, 0, 0));
    S[0][1] = observed(m, &p, PH, 0, 1);
    S[1][1] = fo_add(m->noise, observed(m, &p, PH, 1, 1));
    const fo_dual det = fo_msub(fo_mul(S[0][0], S[1][1]), S[0][1], S[0][1]);
    if (!(det.v > 0.0) || !isfinite(det.v) || !isfinite(e[0].v)) return false;
    const fo_dual inverse = fo_inverse(det);
    const fo_dual V[2][2] = {{fo_mul(S[1][1], inverse), fo_scale(-1.0, fo_mul(S[0][1], inverse))},
                             {fo_scale(-1.0, fo_mul(S[0][1], inverse)), fo_mul(S[0][0], inverse)}};
    const fo_dual w[2] = {fo_mac(fo_mul(V[0][0], e[0]), V[0][1], e[1]),
                          fo_mac(fo_mul(V[1][0], e[0]), V[1][1], e[1])};
    if (counts) {
        const fo_dual square = fo_mac(fo_mul(e[0], w[0]), e[1], w[1]);
        out->objective += 0.5 * (square.v + log(det.v));
        out->mean_square += 0.5 * square.v;
        out->counted++;
        for (int k = 0; k < FO_L; k++)
            out->score[k] += 0.5 * (square.d[k] + det.d[k] * inverse.v);
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++)
                add_information(V[a][b].v, e[a].d, e[b].d, out->information);
        /* ½ tr(S⁻¹ ∂S S⁻¹ ∂S) */
        double VS[2][2][FO_L];
        for (int k = 0; k < FO_L; k++)
            for (int a = 0; a < 2; a++) {
                VS[a][0][k] = V[a][0].v * S[0][0].d[k] + V[a][1].v * S[0][1].d[k];
                VS[a][1][k] = V[a][0].v * S[0][1].d[k] + V[a][1].v * S[1][1].d[k];
            }
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++) add_information(0.5, VS[a][b], VS[b][a], out->information);
    }
    fo_dual change[STATES];
    for (int r = 0; r < STATES; r++)
        change[r] = fo_mac(fo_mul(PH[r][0], w[0]), PH[r][1], w[1]);
    for (int r = 0; r < STATES; r++) {
        const fo_dual K[2] = {fo_mac(fo_mul(PH[r][0], V[0][0]), PH[r][1], V[1][0]),
                              fo_mac(fo_mul(PH[r][0], V[0][1]), PH[r][1], V[1][1])};
        for (int c = r; c < STATES; c++) {
            x->P[r][c] = fo_msub(fo_msub(x->P[r][c], K[0], PH[c][0]), K[1], PH[c][1]);
            x->P[c][r] = x->P[r][c];
        }
    }
    const fo_pair flux = {change[FLUX_D], change[FLUX_Q]}, drift = {change[DRIFT_D], change[DRIFT_Q]},
                  noise = {change[NOISE_D], change[NOISE_Q]},
                  residual = {fo_mul(m->noise, w[0]), fo_mul(m->noise, w[1])};
    x->flux = fo_added(x->flux, 1.0, fo_turned(flux, p.unit));
    x->drift = fo_added(x->drift, 1.0, fo_turned(drift, p.unit));
    x->noise = fo_added(x->noise, 1.0, fo_turned(noise, p.unit));
    x->residual = fo_turned(residual, p.unit);
    x->measured = true;
    x->angle = fo_add(x->angle, change[ANGLE]);
    x->speed = fo_add(x->speed, change[SPEED]);
    return true;
}

/* Turns the rows `at` and `at` + 1 of P, then its columns, back by the angle of `unit`. */
static void turn_covariance(fo_dual P[STATES][STATES], int at, fo_pair unit)
{
    for (int c = 0; c < STATES; c++) {
        const fo_pair turned = fo_turned_back((fo_pair){P[at][c], P[at + 1][c]}, unit);
        P[at][c] = turned.a;
        P[at + 1][c] = turned.b;
    }
    for (int r = 0; r < STATES; r++) {
        const fo_pair turned = fo_turned_back((fo_pair){P[r][at], P[r][at + 1]}, unit);
        P[r][at] = turned.a;
        P[r][at + 1] = turned.b;
    }
}

typedef struct {
    double h;
    fo_dual keep[2], by_angle[2], pole, gain;
    fo_dual inverse[2], current_by_angle[2]; /* the measurement of the row */
} transition;

/* Errors of the state after an interval, in the coordinates before it. w of the row is the
 * residual: its error is that of the predicted current and noise. */
static void moved(const transition *F, fo_dual e[STATES])
{
    const fo_dual angle = fo_axpy(e[ANGLE], 0.5 * F->h, e[SPEED]);
    for (int a = 0; a < 2; a++) {
        const fo_dual wrong = fo_mac(fo_mac(e[NOISE_D + a], F->inverse[a], e[FLUX_D + a]),
                                     F->current_by_angle[a], e[ANGLE]);
        e[NOISE_D + a] = fo_msub(fo_mul(F->pole, e[NOISE_D + a]), F->gain, wrong);
        e[FLUX_D + a] = fo_mac(fo_axpy(fo_mul(F->keep[a], e[FLUX_D + a]), -F->h, e[DRIFT_D + a]),
                               F->by_angle[a], angle);
    }
    e[ANGLE] = fo_axpy(e[ANGLE], F->h, e[SPEED]);
}

/* Time update over an interval, with the voltage that acts in it. */
static void advance(const fo_log *log, const model *m, fo_pair voltage, state *x)
{
    const double h = log->sample_time;
    const prediction now = predict(m, x->flux, x->angle);
    /* Runge–Kutta: the current turns and decays within the interval. */
    static const double reach[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    fo_pair slope = {fo_constant(0.0), fo_constant(0.0)}, sum = slope;
    for (int stage = 0; stage < 4; stage++) {
        const double at = reach[stage] * h;
        const prediction p =
            stage ? predict(m, fo_added(x->flux, at, slope), fo_axpy(x->angle, at, x->speed)) : now;
        slope = emf(m, x, voltage, fo_turned(p.current, p.unit), log->knee);
        sum = fo_added(sum, weight[stage], slope);
    }
    x->flux = fo_added(x->flux, h / 6.0, sum);
    x->angle = fo_axpy(x->angle, h, x->speed);
    x->noise.a = fo_mac(fo_mul(m->pole, x->noise.a), m->gain, x->residual.a);
    x->noise.b = fo_mac(fo_mul(m->pole, x->noise.b), m->gain, x->residual.b);

    /* δλ⁺ = (1 − g) δλ − h R' ∂i/∂θ (δθ + h/2 δω) − h δv; the mean current of the interval has
     * seen half of the decay. */
    transition F;
    F.h = h;
    F.pole = m->pole;
    F.gain = x->measured ? m->gain : fo_constant(0.0);
    for (int a = 0; a < 2; a++) {
        F.inverse[a] = a ? m->inverse_q : m->inverse_d;
        F.current_by_angle[a] = now.by_angle[a];
        const fo_dual decay = fo_scale(h, fo_mul(m->R, F.inverse[a]));
        const fo_dual mean = fo_shift(1.0, fo_scale(-0.5, decay));
        F.keep[a] = fo_shift(1.0, fo_scale(-1.0, fo_mul(decay, mean)));
        F.by_angle[a] = fo_scale(-h, fo_mul(fo_mul(m->R, mean), now.by_angle[a]));
    }
    for (int c = 0; c < STATES; c++) {
        fo_dual column[STATES];
        for (int r = 0; r < STATES; r++) column[r] = x->P[r][c];
        moved(&F, column);
        for (int r = 0; r < STATES; r++) x->P[r][c] = column[r];
    }
    for (int r = 0; r < STATES; r++) moved(&F, x->P[r]);
    const fo_pair turn = fo_unit(fo_scale(h, x->speed));
    turn_covariance(x->P, FLUX_D, turn);
    turn_covariance(x->P, DRIFT_D, turn);
    turn_covariance(x->P, NOISE_D, turn);
    for (int a = 0; a < 2; a++) {
        x->P[a][a] = fo_axpy(x->P[a][a], h, m->voltage);
        x->P[DRIFT_D + a][DRIFT_D + a] = fo_axpy(x->P[DRIFT_D + a][DRIFT_D + a], h, m->drift);
    }
    x->P[SPEED][SPEED] = fo_axpy(x->P[SPEED][SPEED], h, m->acceleration);
    if (!x->measured) { /* w of this row is unknown */
        const fo_dual more = fo_mul(fo_mul(m->gain, m->gain), m->noise);
        for (int a = NOISE_D; a <= NOISE_Q; a++) x->P[a][a] = fo_add(x->P[a][a], more);
    }
    x->measured = false;
    x->residual = fo_constant_pair(0.0, 0.0);
}

bool fo_innovations(const fo_log *log, const double parameters[FO_L], const fo_start *start,
                    fo_likelihood *out, double *angle)
{
    const model m = model_of(parameters);
    state x;
    memset(out, 0, sizeof *out);
    start_at(log, &m, start, &x);
    for (size_t k = 0; k < log->rows; k++) {
        const double *i = log->current + 2 * k, *u = log->voltage + 2 * k;
        const double *before = k > 0 ? u - 2 : u;
        if (isfinite(i[0]) && isfinite(i[1]) && !measure(&m, i, k >= start->skipped, &x, out))
            return false;
        if (angle) angle[k] = x.angle.v;
        if (!isfinite(x.angle.v)) return false;
        const fo_pair voltage = {fo_shift(u[0], fo_scale(before[0] - u[0], m.lag)),
                                 fo_shift(u[1], fo_scale(before[1] - u[1], m.lag))};
        advance(log, &m, voltage, &x);
    }
    if (out->counted) out->mean_square /= (double)out->counted;
    return true;
}
