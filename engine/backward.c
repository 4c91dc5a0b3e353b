#include "backward.h"

#include <math.h>
#include <string.h>

#include "transition.h"

/* Bryson–Frazier form: x_s = x − P λ and P_s = P − P Λ P. The adjoint λ sums up the later
 * innovations; Λ is its covariance. No covariance is inverted, so a state may have no process noise.
 * λ is also the derivative of the objective of the later rows by the predicted state, and
 * ½ (Λ − λ λᵀ) that by its covariance: so they give the score. Derivation: docs/theory.md,
 * section 20. */
enum { S = FO_STATES };

typedef struct {
    double lambda[S], Lambda[S][S];
    double by[S][FO_SENSITIVE]; /* derivatives of λ by the parameters, gain held */
} adjoint;

static double dot(const double *x, const double *y)
{
    double sum = 0.0;
    for (int r = 0; r < S; r++) sum += x[r] * y[r];
    return sum;
}

/* What an interval adds to the score through the covariance: ∂F and the process noise. `after`, `before`: λ at its end
 * and its begin; `excess`: diagonal of Λ − λ λᵀ at its end; `half`: Λ F. */
static void score_of_transition(const fo_model *m, double h, const fo_course *at, const fo_row *row,
                                const fo_elements *elements, const double after[S], const double excess[S],
                                const double before[S], double half[S][S], double *score)
{
    double P_before[S];
    for (int c = 0; c < S; c++) P_before[c] = dot(row->P[c], before);
    double *model = score + FO_FIRST_OF_MODEL;
    for (int n = 0; n < elements->count; n++) {
        const int k = elements->at[n], r = fo_pattern[k][0], c = fo_pattern[k][1];
        if (k >= FO_BENT && r < FO_NOISE) continue;
        /* (P Fᵀ (Λ − λ λᵀ))_cr */
        const double by = dot(row->P[c], half[r]) - P_before[c] * after[r];
        if (k < FO_BENT) {
            for (int j = 0; j < FO_T; j++) model[j] += by * row->F_by[k][j];
        } else if (c == r) {
            score[FO_L_colour_pole] += by;
            if (row->measured) score[FO_L_colour_gain] -= by;
        } else if (row->measured) {
            const int a = r - FO_NOISE, b = c == FO_PSI ? FO_BY_PSI : c;
            score[FO_L_colour_gain] -= by * row->H[a][b];
            for (int j = 0; j < FO_T; j++) model[j] -= m->colour * by * row->H_by[a][b][j];
        }
    }
    const double passed = fabs(h);
    score[FO_L_acceleration] += passed * at->unrest * m->acceleration * excess[FO_ACCELERATION];
    for (int a = 0; a < 2; a++) {
        score[FO_L_voltage] += passed * m->voltage * excess[FO_FLUX + a];
        score[FO_L_drift] += passed * m->drift * excess[FO_DRIFT + a];
        if (row->measured) continue;
        const double more = m->colour * m->noise * excess[FO_NOISE + a];
        score[FO_L_noise] += m->colour * more;
        score[FO_L_colour_gain] += more;
    }
}

/* The interval: λ ← Fᵀ λ, Λ ← Fᵀ Λ F. */
static void pass_transition(const fo_model *m, double h, const fo_course *at, const fo_row *row,
                            const fo_elements *elements, adjoint *a, double *score)
{
    double half[S][S], after[S], excess[S];
    memcpy(after, a->lambda, sizeof after);
    for (int r = 0; r < S; r++) excess[r] = a->Lambda[r][r] - after[r] * after[r];
    fo_times(elements, row->F, true, 1, after, a->lambda);
    fo_on_both_sides(elements, row->F, true, a->Lambda, half);
    if (!score) return;
    score_of_transition(m, h, at, row, elements, after, excess, a->lambda, half, score);
    for (int r = 0; r < S; r++)
        for (int j = 0; j < FO_SENSITIVE; j++) score[FO_LEVELS + j] += after[r] * row->moved_by[r][j];
}

static void pass_transition_by(const fo_row *row, const fo_elements *elements, adjoint *a)
{
    double moved[S][FO_SENSITIVE];
    fo_times(elements, row->F, true, FO_SENSITIVE, a->by[0], moved[0]);
    memcpy(a->by, moved, sizeof moved);
}

/* A measurement on the way back: K'λ, Λ K, K'Λ K; S⁻¹ e; and whether it counts in the adjoint. */
typedef struct {
    double lambda[2], Lambda[S][2], both[2][2], w[2], counts;
} measured;

static measured measured_at(const fo_row *row, const adjoint *a, bool counts)
{
    measured z;
    memset(&z, 0, sizeof z);
    z.counts = counts ? 1.0 : 0.0;
    for (int n = 0; n < 2; n++) {
        z.w[n] = row->V[n][0] * row->error[0] + row->V[n][1] * row->error[1];
        for (int r = 0; r < S; r++) z.lambda[n] += row->K[r][n] * a->lambda[r];
    }
    for (int r = 0; r < S; r++)
        for (int n = 0; n < 2; n++) {
            for (int c = 0; c < S; c++) z.Lambda[r][n] += a->Lambda[r][c] * row->K[c][n];
            for (int b = 0; b < 2; b++) z.both[b][n] += row->K[r][b] * z.Lambda[r][n];
        }
    return z;
}

/* What a measurement adds to the score: through its innovation, and through covariance and gain, ∂R and ∂H. */
static void score_of_measurement(const fo_row *row, const adjoint *a, const measured *z,
                                 double *score)
{
    double by_S[2][2], S_K[2][2], extra[2][2], psi[S][2];
    for (int r = 0; r < 2; r++)
        for (int c = 0; c < 2; c++) {
            const double rest = z->counts * (row->V[r][c] - z->w[r] * z->w[c]);
            by_S[r][c] = rest - z->lambda[r] * z->w[c] - z->w[r] * z->lambda[c] + z->both[r][c] -
                         z->lambda[r] * z->lambda[c];
            extra[r][c] = rest - z->w[r] * z->lambda[c];
            score[FO_L_noise] += by_S[r][c] * row->noise[r][c];
        }
    for (int n = 0; n < 2; n++) {
        const double by_error = z->counts * z->w[n] + z->lambda[n];
        for (int j = 0; j < FO_SENSITIVE; j++) score[FO_LEVELS + j] += by_error * row->error_by[n][j];
    }
    for (int s = 0; s < S; s++)
        for (int n = 0; n < 2; n++)
            psi[s][n] = a->lambda[s] * (z->w[n] + z->lambda[n]) - z->Lambda[s][n];
    /* S times `extra` */
    const double *V0 = row->V[0], *V1 = row->V[1], over = 1.0 / (V0[0] * V1[1] - V0[1] * V1[0]);
    for (int c = 0; c < 2; c++) {
        S_K[0][c] = over * (V1[1] * extra[0][c] - V0[1] * extra[1][c]);
        S_K[1][c] = over * (V0[0] * extra[1][c] - V1[0] * extra[0][c]);
    }
    for (int k = 0; k < FO_BY; k++) {
        const int s = fo_measured_states[k];
        for (int n = 0; n < 2; n++) {
            double by = row->K[s][0] * S_K[0][n] + row->K[s][1] * S_K[1][n];
            for (int r = 0; r < S; r++) by += row->P[s][r] * psi[r][n];
            for (int j = 0; j < FO_T; j++)
                score[FO_FIRST_OF_MODEL + j] += by * row->H_by[n][k][j];
        }
    }
}

/* H with the states of the noise. */
static void whole_slope(const fo_row *row, double H[2][S])
{
    memset(H, 0, sizeof(double) * 2 * S);
    for (int n = 0; n < 2; n++) {
        for (int k = 0; k < FO_BY; k++) H[n][fo_measured_states[k]] = row->H[n][k];
        H[n][FO_NOISE + n] = 1.0;
    }
}

/* λ ← (1 − K H)ᵀ λ − Hᵀ S⁻¹ e, Λ ← (1 − K H)ᵀ Λ (1 − K H) + Hᵀ S⁻¹ H. Of a row that does not count, the
 * innovation still moves the state through the gain: then ½ (Λ − λ λᵀ) is the derivative by the
 * covariance with Λ ← (1 − K H)ᵀ Λ (1 − K H) + λ (S⁻¹ e)ᵀ H + Hᵀ S⁻¹ e λᵀ. */
static void pass_measurement(const fo_row *row, const measured *z, double H[2][S], adjoint *a)
{
    double Z[S][2];
    for (int r = 0; r < S; r++)
        for (int n = 0; n < 2; n++) {
            Z[r][n] = z->Lambda[r][n];
            for (int b = 0; b < 2; b++)
                Z[r][n] -= 0.5 * H[b][r] * (z->both[b][n] + z->counts * row->V[b][n]);
        }
    for (int r = 0; r < S; r++) {
        for (int n = 0; n < 2; n++)
            a->lambda[r] -= H[n][r] * (z->lambda[n] + z->counts * z->w[n]);
        for (int c = 0; c <= r; c++)
            a->Lambda[r][c] -= H[0][r] * Z[c][0] + H[1][r] * Z[c][1] + Z[r][0] * H[0][c] +
                               Z[r][1] * H[1][c];
        for (int c = 0; c < r; c++) a->Lambda[c][r] = a->Lambda[r][c];
    }
    if (z->counts > 0.0) return;
    double Hw[S];
    for (int r = 0; r < S; r++) Hw[r] = H[0][r] * z->w[0] + H[1][r] * z->w[1];
    for (int r = 0; r < S; r++)
        for (int c = 0; c < S; c++)
            a->Lambda[r][c] += a->lambda[r] * Hw[c] + Hw[r] * a->lambda[c];
}

static void pass_measurement_by(const fo_row *row, double H[2][S], adjoint *a)
{
    double g[2][FO_SENSITIVE];
    for (int n = 0; n < 2; n++) {
        for (int j = 0; j < FO_SENSITIVE; j++)
            g[n][j] = row->V[n][0] * row->error_by[0][j] + row->V[n][1] * row->error_by[1][j];
        for (int r = 0; r < S; r++)
            for (int j = 0; j < FO_SENSITIVE; j++) g[n][j] += row->K[r][n] * a->by[r][j];
    }
    for (int r = 0; r < S; r++)
        for (int j = 0; j < FO_SENSITIVE; j++)
            a->by[r][j] -= H[0][r] * g[0][j] + H[1][r] * g[1][j];
}

/* The smoothed state, and its current about the course. */
static void smooth_state(const fo_row *row, const adjoint *a, const fo_course *at, double x[FO_NOISE], double i[2])
{
    for (int s = 0; s < FO_NOISE; s++) x[s] = row->own[s] - dot(row->P[s], a->lambda);
    for (int n = 0; n < 2; n++)
        i[n] = row->current[n] + row->slope[n][FO_BY_ALPHA] * (x[FO_FLUX] - at->flux[0]) +
               row->slope[n][FO_BY_BETA] * (x[FO_FLUX + 1] - at->flux[1]) +
               row->slope[n][FO_BY_ANGLE] * (x[FO_ANGLE] - at->angle) +
               row->slope[n][FO_BY_PSI] * (x[FO_PSI] - at->psi);
}

/* The next place to linearise at: the smoothed angle and current, and the flux that belongs to them. A step of
 * the angle is at most a quarter of a turn, as that of an arrow whose tip moves along the tangent. */
static void smooth_course(const fo_model *m, const fo_row *row, const adjoint *a, fo_course *out)
{
    double x[FO_NOISE], i[2];
    smooth_state(row, a, out, x, i);
    out->angle += atan(x[FO_ANGLE] - out->angle);
    out->psi = x[FO_PSI];
    fo_flux_at(m, out->angle, out->psi, i, out->flux);
}

/* Smoothed noise: R (S⁻¹ e + Kᵀ λ), with the variance R − R (S⁻¹ + Kᵀ Λ K) R; white noise of both
 * components is assumed. */
static double square_of_noise(const fo_row *row, const measured *z, double variance)
{
    double sum = 2.0;
    for (int n = 0; n < 2; n++) {
        const double u = z->w[n] + z->lambda[n];
        sum += variance * (u * u - row->V[n][n] - z->both[n][n]);
    }
    return sum;
}

/* What the parameters add to variances: their covariance, and which of them are not exact. The levels add nothing:
 * in first order, they move no mean. */
typedef struct {
    const double *covariance;
    int at[FO_SENSITIVE], count;
} unknowns;

static unknowns unknowns_of(const double *covariance)
{
    unknowns u = {.covariance = covariance};
    for (int k = 0; covariance && k < FO_SENSITIVE; k++)
        if (covariance[(size_t)(k + FO_LEVELS) * (FO_UNKNOWNS + 1)] > 0.0) u.at[u.count++] = k;
    return u;
}

/* Variance of a quantity with these derivatives by the parameters and this variance `own` with exact ones. Adds `part`
 * of each share, unless `shares` is null. */
static double variance_of(const unknowns *u, const double by[FO_SENSITIVE], double own, double part, double *shares)
{
    double sum = own;
    for (int r = 0; r < u->count; r++) {
        const double *row = u->covariance + (u->at[r] + FO_LEVELS) * FO_UNKNOWNS + FO_LEVELS;
        double across = 0.0;
        for (int c = 0; c < u->count; c++) across += row[u->at[c]] * by[u->at[c]];
        sum += by[u->at[r]] * across;
        if (shares) shares[u->at[r]] += part * by[u->at[r]] * across;
    }
    if (shares) shares[FO_SENSITIVE] += part * own;
    return fmax(sum, 0.0);
}

/* Smoothed variance of a linear combination of the states, and its derivatives by the parameters. */
static double combine(const fo_row *row, const adjoint *a, const double weights[FO_NOISE], double by[FO_SENSITIVE])
{
    double P[S], variance = 0.0;
    for (int r = 0; r < S; r++) {
        P[r] = 0.0;
        for (int s = 0; s < FO_NOISE; s++) P[r] += weights[s] * row->P[s][r];
    }
    for (int s = 0; s < FO_NOISE; s++) variance += weights[s] * P[s];
    for (int r = 0; r < S; r++) variance -= P[r] * dot(P, a->Lambda[r]);
    memset(by, 0, sizeof(double) * FO_SENSITIVE);
    for (int s = 0; s < FO_NOISE; s++)
        for (int j = 0; weights[s] != 0.0 && j < FO_SENSITIVE; j++) by[j] += weights[s] * row->own_by[s][j];
    for (int r = 0; r < S; r++)
        for (int j = 0; j < FO_SENSITIVE; j++) by[j] -= P[r] * a->by[r][j];
    return variance;
}

/* Torque over 3/2 of the pole pairs: of the flux and the current that makes it. */
static void smooth_torque(const fo_row *row, const adjoint *a, const unknowns *u, const double x[FO_NOISE],
                          const double i[2], double *shares, fo_smoothed *out)
{
    double weights[FO_NOISE] = {i[1], -i[0]}, by[FO_SENSITIVE];
    for (int k = 0; k < FO_BY; k++)
        weights[fo_measured_states[k]] += x[FO_FLUX] * row->slope[1][k] - x[FO_FLUX + 1] * row->slope[0][k];
    const double own = combine(row, a, weights, by);
    for (int j = 0; j < FO_SENSITIVE; j++)
        by[j] += x[FO_FLUX] * row->current_by[1][j] - x[FO_FLUX + 1] * row->current_by[0][j];
    out->torque = x[FO_FLUX] * i[1] - x[FO_FLUX + 1] * i[0];
    out->torque_std = sqrt(variance_of(u, by, own, 1.0, shares));
}

static double length_of(const fo_row *row)
{
    const double *e = row->error;
    if (!row->measured) return 0.0;
    const double square = row->V[0][0] * e[0] * e[0] + 2.0 * row->V[0][1] * e[0] * e[1] + row->V[1][1] * e[1] * e[1];
    return sqrt(0.5 * square);
}

/* The current is older than the row by `delay` intervals; angle and flux are those of the row. */
static void smooth_row(const fo_model *m, const fo_row *row, const adjoint *a, const fo_course *at, double h,
                       double delay, const unknowns *u, fo_shares *shares, fo_smoothed *out)
{
    double x[FO_NOISE], i[2], variance[FO_NOISE];
    smooth_state(row, a, at, x, i);
    const double turn = h * row->own[FO_SPEED], late = delay * turn;
    const double re = cos(late), im = sin(late);
    for (int s = 0; s < FO_NOISE; s++) {
        double weights[FO_NOISE] = {0.0}, by[FO_SENSITIVE];
        if (s == FO_ACCELERATION) continue;
        weights[s] = 1.0;
        if (s < 2) {
            weights[0] = s ? im : re;
            weights[1] = s ? re : -im;
        }
        const double own = combine(row, a, weights, by);
        double *share = NULL;
        if (s == FO_ANGLE) by[FO_L_delay - FO_LEVELS] += turn;
        if (s == FO_FLUX) by[FO_L_delay - FO_LEVELS] -= turn * (im * x[0] + re * x[1]);
        if (s == FO_FLUX + 1) by[FO_L_delay - FO_LEVELS] += turn * (re * x[0] - im * x[1]);
        if (s == FO_PSI) by[FO_L_psi_f - FO_LEVELS] += m->psi.d[0];
        if (shares && s == FO_ANGLE) share = (*shares)[FO_SHARES_ANGLE];
        if (shares && s == FO_SPEED) share = (*shares)[FO_SHARES_SPEED];
        if (shares && s < 2) share = (*shares)[FO_SHARES_FLUX];
        variance[s] = variance_of(u, by, own, s < 2 ? 0.5 : 1.0, share);
    }
    *out = (fo_smoothed){.angle = x[FO_ANGLE] + late,
                         .angle_std = sqrt(variance[FO_ANGLE]),
                         .speed = x[FO_SPEED],
                         .speed_std = sqrt(variance[FO_SPEED]),
                         .flux_alpha = re * x[0] - im * x[1],
                         .flux_beta = im * x[0] + re * x[1],
                         .flux_alpha_std = sqrt(variance[0]),
                         .flux_beta_std = sqrt(variance[1]),
                         .psi = x[FO_PSI] + m->psi.d[0],
                         .psi_std = sqrt(variance[FO_PSI]),
                         .drift_alpha = x[FO_DRIFT],
                         .drift_beta = x[FO_DRIFT + 1],
                         .drift_alpha_std = sqrt(variance[FO_DRIFT]),
                         .drift_beta_std = sqrt(variance[FO_DRIFT + 1]),
                         .innovation = length_of(row)};
    smooth_torque(row, a, u, x, i, shares ? (*shares)[FO_SHARES_TORQUE] : NULL, out);
}

/* Where the shares of a row go; null: they are not wanted. */
static fo_shares *shares_of(const fo_outputs *out, size_t row)
{
    const size_t at = out->place + row;
    if (!out->shares || at % out->stride) return NULL;
    fo_shares *shares = out->shares + at / out->stride;
    memset(shares, 0, sizeof *shares);
    return shares;
}

void fo_backward(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_filter *checkpoints, fo_row *rows, const fo_outputs *out, double *score)
{
    const fo_model m = fo_model_of(problem->machine, parameters);
    const fo_elements elements = fo_elements_of(&m);
    const unknowns known = unknowns_of(out->covariance);
    const double h = problem->log->sample_time;
    const size_t count = problem->log->rows, skipped = problem->start->skipped;
    /* `all` counts all rows; rows before `skipped` do not count in the objective. */
    adjoint all, counting;
    fo_course course[FO_CHUNK + 1]; /* of a chunk, and the next row: the output may replace it */
    memset(&all, 0, sizeof all);
    memset(&counting, 0, sizeof counting);
    for (size_t chunk = fo_checkpoints(count); chunk-- > 0;) {
        const size_t first = chunk * FO_CHUNK;
        const size_t length = count - first < FO_CHUNK ? count - first : FO_CHUNK;
        if (first + length < count) course[length] = course[0];
        memcpy(course, problem->course + first, length * sizeof *course);
        fo_again(problem, parameters, checkpoints + chunk, course, length,
                 out->smoothed ? FO_KEEP_SENSITIVE : score ? FO_KEEP_DIRECT : FO_KEEP_VALUES, rows);
        for (size_t k = length; k-- > 0;) {
            const size_t n = first + k;
            const fo_row *row = rows + k;
            const bool counts = n >= skipped;
            if (n + 1 == skipped) counting = all;
            if (out->squares) {
                /* Before its own transition, λ is that of the next row's state: the change has q λ. */
                const double q = fabs(h) * m.acceleration * course[k].unrest;
                const double l = all.lambda[FO_ACCELERATION];
                const double told = q * all.Lambda[FO_ACCELERATION][FO_ACCELERATION];
                out->squares[n].change = 1.0 - told + q * l * l;
                out->squares[n].told = told;
                out->squares[n].noise = 2.0;
            }
            if (n + 1 < count) {
                pass_transition(&m, h, course + k, row, &elements, &all, counts ? score : NULL);
                if (out->smoothed) pass_transition_by(row, &elements, &all);
                if (score && !counts)
                    pass_transition(&m, h, course + k, row, &elements, &counting, score);
            }
            if (out->course) {
                out->course[n] = course[k];
                smooth_course(&m, row, &all, out->course + n);
            }
            if (out->smoothed)
                smooth_row(&m, row, &all, course + k, h, parameters[FO_L_delay], &known, shares_of(out, n),
                           out->smoothed + n);
            if (!row->measured) continue;
            double H[2][S];
            whole_slope(row, H);
            const measured z = measured_at(row, &all, true);
            if (out->squares)
                out->squares[n].noise = square_of_noise(row, &z, m.noise * course[k].doubt);
            if (score && counts) score_of_measurement(row, &all, &z, score);
            pass_measurement(row, &z, H, &all);
            if (out->smoothed) pass_measurement_by(row, H, &all);
            if (!score || counts) continue;
            const measured apart = measured_at(row, &counting, false);
            score_of_measurement(row, &counting, &apart, score);
            pass_measurement(row, &apart, H, &counting);
        }
    }
    if (!score) return;
    /* The predictable noise of the first row. */
    const adjoint *a = skipped ? &counting : &all;
    for (int r = FO_NOISE; r < S; r++) {
        const double more = m.colour * m.noise * (a->Lambda[r][r] - a->lambda[r] * a->lambda[r]);
        score[FO_L_noise] += m.colour * more;
        score[FO_L_colour_gain] += more;
    }
}
