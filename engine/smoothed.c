#include "smoothed.h"

#include <math.h>
#include <string.h>

enum { ANGLE_AND_SPEED = 2 };

static const int own[ANGLE_AND_SPEED] = {FO_ANGLE, FO_SPEED};

/* Bryson–Frazier form: x_s = x − P λ and P_s = P − P Λ P. The adjoint λ sums up the later
 * innovations; Λ is its covariance. No covariance is inverted, so a state may have no process noise.
 * λ carries its derivatives by the parameters, with the gain held. */
typedef struct {
    double lambda[FO_STATES], Lambda[FO_STATES][FO_STATES];
    double by[FO_STATES][FO_UNKNOWNS];
} adjoint;

/* y ← Mᵀ y for λ, its derivatives and, from both sides, Λ. */
static void transform(double M[FO_STATES][FO_STATES], adjoint *a)
{
    adjoint b;
    double T[FO_STATES][FO_STATES];
    memset(&b, 0, sizeof b);
    memset(T, 0, sizeof T);
    for (int k = 0; k < FO_STATES; k++)
        for (int r = 0; r < FO_STATES; r++) {
            const double m = M[k][r];
            if (m == 0.0) continue;
            b.lambda[r] += m * a->lambda[k];
            for (int c = 0; c < FO_STATES; c++) T[r][c] += m * a->Lambda[k][c];
            for (int c = 0; c < FO_UNKNOWNS; c++) b.by[r][c] += m * a->by[k][c];
        }
    for (int r = 0; r < FO_STATES; r++)
        for (int k = 0; k < FO_STATES; k++)
            for (int c = 0; c < FO_STATES; c++) b.Lambda[r][c] += T[r][k] * M[k][c];
    *a = b;
}

/* The row's measurement: λ ← (1 − K H)ᵀ λ − Hᵀ S⁻¹ e, Λ ← (1 − K H)ᵀ Λ (1 − K H) + Hᵀ S⁻¹ H. */
static void add_measurement(const fo_row *row, adjoint *a)
{
    double M[FO_STATES][FO_STATES], VH[2][FO_STATES];
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < FO_STATES; c++)
            M[r][c] = (r == c) - row->K[r][0] * row->H[0][c] - row->K[r][1] * row->H[1][c];
    transform(M, a);
    for (int b = 0; b < 2; b++)
        for (int c = 0; c < FO_STATES; c++)
            VH[b][c] = row->inverse[b][0] * row->H[0][c] + row->inverse[b][1] * row->H[1][c];
    for (int r = 0; r < FO_STATES; r++) {
        a->lambda[r] -= VH[0][r] * row->error[0] + VH[1][r] * row->error[1];
        for (int c = 0; c < FO_STATES; c++)
            a->Lambda[r][c] += row->H[0][r] * VH[0][c] + row->H[1][r] * VH[1][c];
        for (int c = 0; c < FO_UNKNOWNS; c++)
            a->by[r][c] -= VH[0][r] * row->error_by[0][c] + VH[1][r] * row->error_by[1][c];
    }
}

/* Variance that the parameters add to a state, from its derivatives. */
static double share_of_parameters(const double *by, const double *covariance)
{
    double sum = 0.0;
    for (int r = 0; r < FO_UNKNOWNS; r++) {
        double own_sum = 0.0;
        for (int c = 0; c < FO_UNKNOWNS; c++) own_sum += covariance[r * FO_UNKNOWNS + c] * by[c];
        sum += by[r] * own_sum;
    }
    return sum;
}

void fo_smooth(const fo_row *rows, size_t count, const double *covariance, fo_smoothed *out)
{
    adjoint a;
    memset(&a, 0, sizeof a);
    for (size_t n = count; n-- > 0;) {
        const fo_row *row = rows + n;
        if (n + 1 < count) {
            double F[FO_STATES][FO_STATES];
            memcpy(F, row->F, sizeof F);
            transform(F, &a);
        }
        double value[ANGLE_AND_SPEED], std[ANGLE_AND_SPEED];
        for (int s = 0; s < ANGLE_AND_SPEED; s++) {
            const double *P = row->P[own[s]];
            double variance = P[own[s]], by[FO_UNKNOWNS];
            value[s] = s ? row->speed : row->angle;
            memcpy(by, row->state_by[s], sizeof by);
            for (int r = 0; r < FO_STATES; r++) {
                double PL = 0.0;
                for (int c = 0; c < FO_STATES; c++) PL += P[c] * a.Lambda[c][r];
                variance -= PL * P[r];
                value[s] -= P[r] * a.lambda[r];
                for (int c = 0; c < FO_UNKNOWNS; c++) by[c] -= P[r] * a.by[r][c];
            }
            if (covariance) variance += share_of_parameters(by, covariance);
            std[s] = sqrt(fmax(variance, 0.0));
        }
        out[n] = (fo_smoothed){value[0], std[0], value[1], std[1]};
        if (row->measured) add_measurement(row, &a);
    }
}
