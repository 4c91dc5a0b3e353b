#include "exact_file.h"

#include <math.h>
#include <string.h>

#include "cholesky.h"

/* Values of the machine file. */
static const int of_file[] = {FO_L_resistance, FO_L_L_d, FO_L_L_q, FO_L_psi_f};
enum { OF_FILE = 4 };

/* Values that are held as in the file, with the steps by which they differ from it. */
typedef struct {
    int count, at[OF_FILE];
    double step[OF_FILE];
} held_values;

static held_values stated_values(const fo_trial *t, const fo_posterior *at)
{
    held_values v = {0, {0}, {0.0}};
    for (int n = 0; n < OF_FILE; n++) {
        const int k = of_file[n];
        const bool stated = t->prior->std[k] > 0.0 && !(k == FO_L_psi_f && t->guessed);
        if (!stated || (t->prior->round && k == FO_L_L_q)) continue;
        v.at[v.count] = k;
        v.step[v.count++] = at->parameters[k] - t->prior->mean[k];
    }
    return v;
}

/* Covariance of the held values, as a factor; see fo_factor. */
typedef struct {
    double R[FO_UNKNOWNS][FO_UNKNOWNS], scale[FO_UNKNOWNS];
} spread;

/* False: the covariance is singular. */
static bool spread_of(const double *covariance, const held_values *v, spread *out)
{
    double C[FO_UNKNOWNS][FO_UNKNOWNS], none[FO_UNKNOWNS] = {0.0};
    for (int r = 0; r < v->count; r++)
        for (int c = 0; c < v->count; c++) C[r][c] = covariance[v->at[r] * FO_UNKNOWNS + v->at[c]];
    return fo_factor(v->count, C, 0.0, none, out->scale, out->R);
}

/* Evidence against values of the file that convinces: 20 to 1 (ln). */
static const double convincing = 3.0;

/* Half squares by which exact values of the file may explain the log worse: other values are spread over the prior, and
 * the log leaves these over the posterior (Occam factor). */
static double margin_of(const fo_trial *t, const held_values *v, const spread *s)
{
    double sum = convincing;
    for (int r = 0; r < v->count; r++) sum += log(t->prior->std[v->at[r]] * s->scale[r] / s->R[r][r]);
    return sum;
}

/* Parameters with the values of the file; the others, but levels and colour, have their means if these are given.
 * Voltages are linear in the values, of which the parameters are logarithms. Returns the half squares that it should
 * cost. */
static double hold(const fo_trial *t, const held_values *v, spread *s, const double *C, double *p)
{
    double change[OF_FILE], x[OF_FILE], shift[FO_UNKNOWNS] = {0.0}, cost = 0.0;
    for (int n = 0; n < v->count; n++) change[n] = expm1(-v->step[n]);
    fo_solve(v->count, s->R, s->scale, change, x);
    for (int n = 0; n < v->count; n++) {
        cost += 0.5 * change[n] * x[n];
        for (int k = FO_VARIANCES; k < FO_UNKNOWNS; k++) shift[k] += C[k * FO_UNKNOWNS + v->at[n]] * x[n];
    }
    for (int k = FO_VARIANCES; k < FO_UNKNOWNS; k++) p[k] += shift[k];
    for (int n = 0; n < OF_FILE; n++) {
        const int k = of_file[n];
        p[k] += log1p(fmax(shift[k], -0.9)) - shift[k];
    }
    for (int n = 0; n < v->count; n++) p[v->at[n]] = t->prior->mean[v->at[n]];
    if (t->prior->round) p[FO_L_L_q] = p[FO_L_L_d];
    return cost;
}

/* Evaluations of exact values, the first and the others, and half squares that the others may gain. Exact values that
 * should cost so many margins are not tried: what has been learnt is hardly a poor minimum. Assumed. */
enum { AS_FILED = 10, MORE = 30 };
static const double hopeful = 50.0, hopeless = 3.0;

/* Are these values those of the file, exactly? If they explain the log as well, they count from now on; or better, if
 * that should have cost more. */
static bool try_held(const fo_trial *t, const held_values *v, fo_posterior *posterior)
{
    spread s;
    fo_posterior tried = *posterior;
    fo_prior exact = *t->prior;
    fo_work w = *t->work;
    if (!v->count || !spread_of(posterior->covariance, v, &s)) return false;
    const double margin = margin_of(t, v, &s), cost = hold(t, v, &s, posterior->covariance, tried.parameters);
    const double limit = posterior->objective + (cost < margin ? margin : 0.0);
    if (cost > hopeless * margin) return false;
    for (int n = 0; n < v->count; n++) exact.std[v->at[n]] = 0.0;
    if (exact.round) exact.std[FO_L_L_q] = exact.std[FO_L_L_d];
    w.problem.course = t->course;
    w.held = true; /* or the exact values would gain what more steps of doubt and unrest give anyway */
    memcpy(t->course, t->work->problem.course, w.problem.log->rows * sizeof *t->course);
    bool learnt = fo_learn_parts(&w, &exact, FO_FINE, AS_FILED, &tried);
    if (learnt && !tried.converged && tried.objective < limit + hopeful)
        learnt = fo_learn_parts(&w, &exact, FO_FINE, MORE, &tried);
    posterior->evaluations = tried.evaluations;
    if (!learnt || !(tried.objective < limit)) return false;
    *posterior = tried;
    return true;
}

/* A value that differs from the file by more of its prior's standard deviations is wrong: one in 370 does. */
static const double wrong = 3.0;

bool fo_try_file(const fo_trial *t, fo_posterior *posterior)
{
    const held_values v = stated_values(t, posterior);
    for (int n = 0; n < v.count; n++)
        if (fabs(v.step[n]) > wrong * t->prior->std[v.at[n]]) return false;
    return fo_course_covariance(t->work, t->prior, posterior) && try_held(t, &v, posterior);
}
