#include "posterior.h"

#include <math.h>
#include <string.h>

enum { MOST = FO_UNKNOWNS, MACHINE = FO_L_psi_f + 1 };

/* Assumed: one machine file in twenty describes another machine, and its errors are five times as
 * large. */
static const double other_machines = 0.05, wider = 5.0;
static const double any_angle = 1.8137993642342178; /* π/√3: the std of a uniform angle [rad] */
/* The level of the harmonics has an inverse gamma prior. It counts like two coefficients, each a
 * tenth of the scale. */
static const double harmonics_weight = 2.0, harmonics_share = 0.1;

typedef struct {
    double value, slope[FO_UNKNOWNS], curvature[FO_UNKNOWNS];
} penalty;

/* −ln[(1 − ε) N(δ; σ) + ε N(δ; kσ)] without constant; the curvature is that of the mixture at fixed
 * weights, which is positive. */
static void add_heavy(double difference, double std, int k, penalty *out)
{
    const double d = difference / std, e = d / wider;
    const double near = (1.0 - other_machines) * exp(-0.5 * d * d);
    const double far = other_machines / wider * exp(-0.5 * e * e);
    const double share = far / (near + far);
    const double stiffness = ((1.0 - share) + share / (wider * wider)) / (std * std);
    out->value -= log(near + far) - log(1.0 - other_machines + other_machines / wider);
    out->slope[k] = stiffness * difference;
    out->curvature[k] = stiffness;
}

static penalty penalty_at(const fo_prior *prior, const double *p, double harmonics)
{
    penalty out = {0.0, {0.0}, {0.0}};
    for (int k = 0; k < FO_L; k++) {
        const double std = prior->std[k], difference = p[k] - prior->mean[k];
        if (!(std > 0.0) || (prior->round && k == FO_L_L_q)) continue;
        if (k < MACHINE) {
            add_heavy(difference, std, k, &out);
            continue;
        }
        out.value += 0.5 * difference * difference / (std * std);
        out.slope[k] = difference / (std * std);
        out.curvature[k] = 1.0 / (std * std);
    }
    if (!(prior->harmonics > 0.0)) return out;
    for (int k = FO_L; k < FO_TURN; k++) {
        const double d = p[k] / harmonics;
        out.value += 0.5 * d * d + log(harmonics);
        out.slope[k] = d / harmonics;
        out.curvature[k] = 1.0 / (harmonics * harmonics);
    }
    out.value += 0.5 * harmonics_weight *
                 (pow(harmonics_share * prior->harmonics / harmonics, 2.0) + 2.0 * log(harmonics));
    return out;
}

/* Indices of the free parameters. If the machine has one inductance, L_q moves with L_d. */
typedef struct {
    int count, at[MOST];
    bool round;
} selection;

static selection selected(const fo_prior *prior, const bool *free, bool turn)
{
    selection s = {0, {0}, prior->round};
    for (int k = 0; k < FO_UNKNOWNS; k++) {
        const bool own = k == FO_TURN ? turn
                         : k >= FO_L  ? prior->harmonics > 0.0
                                   : prior->std[k] > 0.0 && (!free || free[k]) &&
                                         !(prior->round && k == FO_L_L_q);
        if (own) s.at[s.count++] = k;
    }
    return s;
}

/* Gradient and curvature of the free parameters, from those of all. */
static void reduced(const selection *s, const fo_likelihood *at, const penalty *own, double *g,
                    double H[MOST][MOST])
{
    double score[FO_UNKNOWNS], M[FO_UNKNOWNS][FO_UNKNOWNS];
    memcpy(score, at->score, sizeof score);
    memcpy(M, at->information, sizeof M);
    for (int k = 0; k < FO_UNKNOWNS; k++) {
        score[k] += own->slope[k];
        M[k][k] += own->curvature[k];
    }
    if (s->round) {
        score[FO_L_L_d] += score[FO_L_L_q];
        for (int k = 0; k < FO_UNKNOWNS; k++) M[FO_L_L_d][k] += M[FO_L_L_q][k];
        for (int k = 0; k < FO_UNKNOWNS; k++) M[k][FO_L_L_d] += M[k][FO_L_L_q];
    }
    for (int r = 0; r < s->count; r++) {
        g[r] = score[s->at[r]];
        for (int c = 0; c < s->count; c++) H[r][c] = M[s->at[r]][s->at[c]];
    }
}

/* Cholesky factor of H with its diagonal raised by the factor 1 + μ, scaled to a diagonal of ones:
 * the units of the parameters differ by many powers of ten. */
static bool factor(int n, double H[MOST][MOST], double mu, double scale[MOST],
                   double R[MOST][MOST])
{
    for (int r = 0; r < n; r++) {
        if (!(H[r][r] > 0.0) || !isfinite(H[r][r])) return false;
        scale[r] = 1.0 / sqrt(H[r][r]);
    }
    for (int r = 0; r < n; r++)
        for (int c = 0; c <= r; c++) {
            double sum = H[r][c] * scale[r] * scale[c] + (r == c ? mu : 0.0);
            for (int k = 0; k < c; k++) sum -= R[r][k] * R[c][k];
            if (r != c) {
                R[r][c] = sum / R[c][c];
            } else {
                if (!(sum > 1e-14) || !isfinite(sum)) return false;
                R[r][r] = sqrt(sum);
            }
        }
    return true;
}

static void solve(int n, double R[MOST][MOST], const double scale[MOST], const double *b, double *x)
{
    for (int r = 0; r < n; r++) {
        x[r] = b[r] * scale[r];
        for (int k = 0; k < r; k++) x[r] -= R[r][k] * x[k];
        x[r] /= R[r][r];
    }
    for (int r = n - 1; r >= 0; r--) {
        for (int k = r + 1; k < n; k++) x[r] -= R[k][r] * x[k];
        x[r] /= R[r][r];
    }
    for (int r = 0; r < n; r++) x[r] *= scale[r];
}

/* Longest step of a parameter: where the filter's linearisation still holds. */
static double longest(const fo_prior *prior, int k)
{
    if (k < MACHINE) return 0.2; /* logarithms: 20 % */
    switch (k) {
    case FO_L_loss:
    case FO_L_mobility: return prior->std[k];
    case FO_L_lag: return 0.3;
    case FO_L_colour_pole:
    case FO_L_colour_gain: return 0.2;
    default: return k < FO_L ? 0.7 : HUGE_VAL; /* logarithms of levels: twofold */
    }
}

/* Covariance of all parameters, from the curvature of the free ones. */
static bool invert(const selection *s, double H[MOST][MOST], double *covariance)
{
    double R[MOST][MOST], scale[MOST], unit[MOST] = {0.0}, column[MOST];
    memset(covariance, 0, sizeof(double) * FO_UNKNOWNS * FO_UNKNOWNS);
    double ridge = 0.0; /* relative; needed where the filter has lost the rotor */
    while (!factor(s->count, H, ridge, scale, R)) {
        ridge = ridge > 0.0 ? 100.0 * ridge : 1e-12;
        if (ridge > 1e-3) return false;
    }
    for (int c = 0; c < s->count; c++) {
        unit[c] = 1.0;
        solve(s->count, R, scale, unit, column);
        unit[c] = 0.0;
        for (int r = 0; r < s->count; r++)
            covariance[s->at[r] * FO_UNKNOWNS + s->at[c]] = column[r];
    }
    if (s->round) {
        for (int k = 0; k < FO_UNKNOWNS; k++)
            covariance[FO_L_L_q * FO_UNKNOWNS + k] = covariance[FO_L_L_d * FO_UNKNOWNS + k];
        for (int k = 0; k < FO_UNKNOWNS; k++)
            covariance[k * FO_UNKNOWNS + FO_L_L_q] = covariance[k * FO_UNKNOWNS + FO_L_L_d];
    }
    return true;
}

bool fo_covariance(const fo_likelihood *at, const fo_prior *prior, fo_posterior *out)
{
    const selection s = selected(prior, NULL, true);
    double g[MOST], H[MOST][MOST];
    penalty own = penalty_at(prior, out->parameters, out->harmonics);
    own.curvature[FO_TURN] = 1.0 / (any_angle * any_angle);
    reduced(&s, at, &own, g, H);
    return invert(&s, H, out->covariance);
}

/* Level at which the expected coefficients and the prior agree (ML-II, one step of EM). */
static double level(const fo_prior *prior, const fo_posterior *at)
{
    double sum = harmonics_weight * pow(harmonics_share * prior->harmonics, 2.0);
    for (int k = FO_L; k < FO_TURN; k++)
        sum += at->parameters[k] * at->parameters[k] + at->covariance[k * FO_UNKNOWNS + k];
    return sqrt(sum / (2 * FO_ORDERS + harmonics_weight));
}

bool fo_maximise(const fo_log *log, const fo_start *start, const fo_prior *prior, const bool *free,
                 double gain, size_t most, fo_posterior *out)
{
    const selection s = selected(prior, free, false);
    fo_likelihood at, next;
    double g[MOST], H[MOST][MOST], R[MOST][MOST], scale[MOST], step[MOST];
    double damping = 1e-3, gained = HUGE_VAL;
    out->evaluations = 1;
    out->converged = false;
    if (!fo_innovations(log, out->parameters, start, &at, NULL) || !isfinite(at.objective))
        return false;
    penalty own = penalty_at(prior, out->parameters, out->harmonics);
    for (size_t n = 0;; n++) {
        out->objective = at.objective + own.value;
        out->mean_square = at.mean_square;
        reduced(&s, &at, &own, g, H);
        if (!invert(&s, H, out->covariance)) return false;
        /* The level moves once the first steps have removed what is not harmonic. */
        if (prior->harmonics > 0.0 && n >= 3 && gained >= gain) {
            out->harmonics = level(prior, out);
            own = penalty_at(prior, out->parameters, out->harmonics);
            out->objective = at.objective + own.value;
            reduced(&s, &at, &own, g, H);
        }
        if (gained < gain) out->converged = true;
        if (out->converged || out->evaluations >= most) break;
        bool better = false;
        for (; !better && damping < 1e9 && out->evaluations < most; damping *= better ? 1.0 : 8.0) {
            if (!factor(s.count, H, damping, scale, R)) continue;
            solve(s.count, R, scale, g, step);
            double share = 1.0, moved[FO_UNKNOWNS];
            for (int k = 0; k < s.count; k++)
                share = fmin(share, longest(prior, s.at[k]) / fmax(fabs(step[k]), 1e-300));
            memcpy(moved, out->parameters, sizeof moved);
            for (int k = 0; k < s.count; k++) moved[s.at[k]] -= share * step[k];
            if (s.round) moved[FO_L_L_q] += moved[FO_L_L_d] - out->parameters[FO_L_L_d];
            out->evaluations++;
            if (!fo_innovations(log, moved, start, &next, NULL)) continue;
            const penalty theirs = penalty_at(prior, moved, out->harmonics);
            gained = out->objective - next.objective - theirs.value;
            better = gained > 0.0; /* false for what is not a number */
            if (!better) continue;
            memcpy(out->parameters, moved, sizeof moved);
            at = next;
            own = theirs;
        }
        damping = fmax(0.15 * damping, 1e-12);
        if (!better) { /* no step is better: a minimum, as far as rounding tells */
            out->converged = out->evaluations < most;
            break;
        }
    }
    return true;
}
