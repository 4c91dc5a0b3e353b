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

/* What an interval adds to the score: ∂F and the process noise. `after`, `before`: λ at its end and its
 * begin; `excess`: diagonal of Λ − λ λᵀ at its end; `half`: Λ F. */
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
    if (score)
        score_of_transition(m, h, at, row, elements, after, excess, a->lambda, half, score);
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

/* What a measurement adds to the score through its covariance and the gain: ∂R and ∂H. */
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
        for (int c = 0; c < S; c++)
            a->Lambda[r][c] -= H[0][r] * Z[c][0] + H[1][r] * Z[c][1] + Z[r][0] * H[0][c] +
                               Z[r][1] * H[1][c];
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

/* The next place to linearise at: the smoothed angle and current, and the flux that belongs to them. A step of
 * the angle is at most a quarter of a turn, as that of an arrow whose tip moves along the tangent. */
static void smooth_course(const fo_model *m, const fo_row *row, const adjoint *a, fo_course *out)
{
    double x[FO_OWN], i[2];
    for (int s = 0; s < FO_OWN; s++) x[s] = row->own[s] - dot(row->P[s], a->lambda);
    const double turn = x[FO_ANGLE] - out->angle;
    for (int n = 0; n < 2; n++)
        i[n] = row->current[n] + row->slope[n][FO_BY_ALPHA] * (x[FO_FLUX] - out->flux[0]) +
               row->slope[n][FO_BY_BETA] * (x[FO_FLUX + 1] - out->flux[1]) +
               row->slope[n][FO_BY_ANGLE] * turn + row->slope[n][FO_BY_PSI] * (x[FO_PSI] - out->psi);
    out->angle += atan(turn);
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

/* Variance that the parameters add to a state, from its derivatives. The levels add nothing: in first
 * order, they move no mean. */
static double share_of_parameters(const double by[FO_SENSITIVE], const double *covariance)
{
    double sum = 0.0;
    for (int r = 0; r < FO_SENSITIVE; r++) {
        const double *row = covariance + (r + FO_LEVELS) * FO_UNKNOWNS + FO_LEVELS;
        double own = 0.0;
        for (int c = 0; c < FO_SENSITIVE; c++) own += row[c] * by[c];
        sum += by[r] * own;
    }
    return sum;
}

static void smooth_row(const fo_row *row, const adjoint *a, double h, double delay,
                       const double *covariance, fo_smoothed *out)
{
    static const int own[2] = {FO_ANGLE, FO_SPEED};
    double value[2], std[2];
    for (int s = 0; s < 2; s++) {
        const double *P = row->P[own[s]];
        double variance = P[own[s]], by[FO_SENSITIVE];
        memcpy(by, row->own_by[s], sizeof by);
        value[s] = row->own[own[s]] - dot(P, a->lambda);
        for (int r = 0; r < S; r++) {
            variance -= P[r] * dot(P, a->Lambda[r]);
            for (int j = 0; j < FO_SENSITIVE; j++) by[j] -= P[r] * a->by[r][j];
        }
        if (s == 0) { /* The current is older than the row, and the angle is that of the row. */
            const double turn = h * row->own[FO_SPEED];
            value[s] += delay * turn;
            by[FO_L_delay - FO_LEVELS] += turn;
        }
        std[s] = sqrt(fmax(variance + share_of_parameters(by, covariance), 0.0));
    }
    *out = (fo_smoothed){value[0], std[0], value[1], std[1]};
}

void fo_backward(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_filter *checkpoints, fo_row *rows, const fo_outputs *out, double *score)
{
    const fo_model m = fo_model_of(problem->machine, parameters);
    const fo_elements elements = fo_elements_of(&m);
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
        fo_again(problem, parameters, checkpoints + chunk, course, length, out->smoothed, rows);
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
                smooth_row(row, &all, h, parameters[FO_L_delay], out->covariance,
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
