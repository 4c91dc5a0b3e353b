#include "posterior.h"

#include <math.h>
#include <string.h>

#include "cholesky.h"

enum { MOST = FO_UNKNOWNS };

/* Assumed: one machine file in twenty describes another machine, and its errors are five times as
 * large. */
static const double other_machines = 0.05, wider = 5.0;
/* Iron does not deliver power: its loss is hardly below zero, by this share of its std. And a simulated drive lacks
 * errors that others have: the logarithm of a level may be below its mean by so many times its std. Assumed. */
static const double below = 0.1, calm = 4.0;
/* The level of the harmonics has an inverse gamma prior. It counts like two coefficients, each a
 * tenth of the scale. */
static const double harmonics_weight = 2.0, harmonics_share = 0.1;

/* Half squares by which an evaluation may be worse than the last: a new course or unrest moves the
 * objective by about that much. Assumed. */
static const double slack = 2.0;
/* ln: no sensor is thirty times as quiet as an ordinary one, although a flat log is. Assumed. */
static const double quietest = 3.4;
static const double largest_damping = 1e9;

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

static bool is_level(int k)
{
    return k < FO_LEVELS;
}

static bool is_of_file(int k)
{
    return k == FO_L_resistance || k == FO_L_L_d || k == FO_L_L_q || k == FO_L_psi_f;
}

static double std_of(const fo_prior *prior, int k, double difference)
{
    const double less = k == FO_L_iron_loss ? below : is_level(k) ? calm : 1.0;
    return prior->std[k] * (difference < 0.0 ? less : 1.0);
}

static penalty penalty_at(const fo_prior *prior, const double *p, double harmonics)
{
    penalty out = {0.0, {0.0}, {0.0}};
    for (int k = 0; k < FO_L; k++) {
        const double difference = p[k] - prior->mean[k], std = std_of(prior, k, difference);
        if (!(std > 0.0) || (prior->round && k == FO_L_L_q)) continue;
        if (!prior->normal && (is_of_file(k) || k == FO_L_lag)) {
            add_heavy(difference, std, k, &out);
            continue;
        }
        out.value += 0.5 * difference * difference / (std * std);
        out.slope[k] = difference / (std * std);
        out.curvature[k] = 1.0 / (std * std);
    }
    if (!(prior->harmonics > 0.0)) return out;
    for (int k = FO_L; k < FO_UNKNOWNS; k++) {
        const double d = p[k] / harmonics;
        out.value += 0.5 * d * d + log(harmonics);
        out.slope[k] = d / harmonics;
        out.curvature[k] = 1.0 / (harmonics * harmonics);
    }
    out.value += 0.5 * harmonics_weight *
                 (pow(harmonics_share * prior->harmonics / harmonics, 2.0) + 2.0 * log(harmonics));
    return out;
}

double fo_conflict_of(const fo_prior *prior, const fo_posterior *at)
{
    fo_prior own = *prior;
    double p[FO_UNKNOWNS], sum = 0.0;
    memcpy(p, at->parameters, sizeof p);
    for (int k = 0; k < FO_LEVELS; k++) p[k] = fmax(p[k], prior->mean[k]);
    p[FO_L_loss] = fmax(p[FO_L_loss], prior->mean[FO_L_loss]);
    own.std[FO_L_knee] = own.harmonics = 0.0;
    for (int k = FO_L; prior->harmonics > 0.0 && k < FO_UNKNOWNS; k++) sum += pow(p[k] / prior->harmonics, 2.0);
    return 2.0 * penalty_at(&own, p, 1.0).value + sum;
}

/* Indices of the free parameters. If the machine has one inductance, L_q moves with L_d. */
typedef struct {
    int count, at[MOST];
    bool round;
} selection;

static selection selected(const fo_prior *prior)
{
    selection s = {0, {0}, prior->round};
    for (int k = 0; k < FO_UNKNOWNS; k++) {
        const bool own = k >= FO_L ? prior->harmonics > 0.0
                                   : prior->std[k] > 0.0 && !(prior->round && k == FO_L_L_q);
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

/* Longest step of a parameter: where the filter's linearisation still holds. */
static double longest(const fo_prior *prior, int k)
{
    if (k >= FO_L) return prior->harmonics;
    if (is_of_file(k)) return 0.2; /* logarithms: 20 % */
    switch (k) {
    case FO_L_rotation:
    case FO_L_iron_loss:
    case FO_L_heat:
    case FO_L_saturation_d:
    case FO_L_saturation_q:
    case FO_L_rotor_resistance:
    case FO_L_magnetizing:
    case FO_L_range:
    case FO_L_offset_alpha:
    case FO_L_offset_beta:
    case FO_L_gain_re:
    case FO_L_gain_im:
    case FO_L_mobility: return 2.0 * prior->std[k];
    case FO_L_lag:
    case FO_L_delay: return 0.3;
    case FO_L_colour_pole:
    case FO_L_colour_gain: return 0.2;
    default: return 2.0; /* logarithms of levels */
    }
}

/* Covariance of all parameters, from the curvature of the free ones. */
static bool invert(const selection *s, double H[MOST][MOST], double *covariance)
{
    double R[MOST][MOST], scale[MOST], unit[MOST] = {0.0}, column[MOST];
    memset(covariance, 0, sizeof(double) * FO_UNKNOWNS * FO_UNKNOWNS);
    double ridge = 0.0, diagonal[MOST]; /* relative; needed where the filter has lost the rotor */
    for (int k = 0; k < s->count; k++) diagonal[k] = H[k][k];
    while (!fo_factor(s->count, H, ridge, diagonal, scale, R)) {
        ridge = ridge > 0.0 ? 100.0 * ridge : 1e-12;
        if (ridge > 1e-3) return false;
    }
    for (int c = 0; c < s->count; c++) {
        unit[c] = 1.0;
        fo_solve(s->count, R, scale, unit, column);
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
    const selection s = selected(prior);
    double g[MOST], H[MOST][MOST];
    const penalty own = penalty_at(prior, out->parameters, out->harmonics);
    reduced(&s, at, &own, g, H);
    return invert(&s, H, out->covariance);
}

/* Level at which the evidence is largest: the coefficients that the log tells, in number Σ (1 − variance/level²),
 * and the prior agree (MacKay's fixed point; EM creeps where the log hardly tells them). */
static double level(const fo_prior *prior, const fo_posterior *at)
{
    const double now = at->harmonics * at->harmonics;
    double sum = harmonics_weight * pow(harmonics_share * prior->harmonics, 2.0), told = 0.0;
    for (int k = FO_L; k < FO_UNKNOWNS; k++) {
        sum += at->parameters[k] * at->parameters[k];
        told += fmax(1.0 - at->covariance[k * FO_UNKNOWNS + k] / now, 0.0);
    }
    return sqrt(sum / (told + harmonics_weight));
}

/* How many rows the prior of the unrest counts, in stretches of FO_STRETCH: a load
 * step is over within a few rows, and calm rows tell little one by one. Chosen by hand on a servo of
 * tests/engine/drive_table.py: L −9 % with one level, −4.6 % with 100 rows, −4.2 % with 25. */
static const double calm_rows = 1.0;

/* What the currents say about the unrest of a stretch. They see `count` sums of its changes, each with the share
 * `told` of its variance: the variance of their own error is then 1/told − 1 times that of the sum. `square`: Σ q λ²,
 * which is the square of the sums' observed values times told². */
typedef struct {
    double count, told, square, unrest;
} stretch_of_unrest;

/* −2 ln of the posterior as a function of x = ln of the ratio to the unrest that the smoother assumed. */
static double of_unrest(const stretch_of_unrest *s, double x)
{
    const double variance = exp(x) + 1.0 / s->told - 1.0;
    return s->count * log(variance) + s->square / (s->told * s->told * variance) +
           calm_rows * (exp(-x) / s->unrest + x);
}

/* Where the posterior is largest within a step of `longest`: it may have two maxima, a calm one and a wild one. */
static double best_unrest(const stretch_of_unrest *s)
{
    enum { POINTS = 14 };
    static const double longest = 1.4;
    const double apart = longest / (double)POINTS;
    double x = 0.0, least = of_unrest(s, 0.0);
    for (int n = -POINTS; n <= POINTS; n++) {
        const double own = of_unrest(s, (double)n * apart);
        if (own >= least) continue;
        least = own;
        x = (double)n * apart;
    }
    if (fabs(x) > longest - 0.5 * apart) return x;
    const double before = of_unrest(s, x - apart), after = of_unrest(s, x + apart);
    const double bend = before + after - 2.0 * least;
    return bend > 0.0 ? x + 0.5 * apart * (before - after) / bend : x;
}

/* Currents that tell a larger share than this see more than one sum. */
static const double all_told = 0.99;

/* The unrest of each stretch, with an inverse gamma prior about one. */
static void learn_unrest(const fo_log *record, const fo_squares *made, fo_course *course)
{
    for (size_t first = 0; first < record->rows; first += FO_STRETCH) {
        const size_t end = first + FO_STRETCH < record->rows ? first + FO_STRETCH : record->rows;
        double told = 0.0, square = 0.0;
        for (size_t k = first; k < end; k++) {
            told += made[k].told;
            square += made[k].change - 1.0 + made[k].told;
        }
        told = fmax(told, 1e-9);
        const double count = fmax(ceil(told / all_told), 1.0);
        const stretch_of_unrest own = {count, told / count, square, course[first].unrest};
        const double unrest = course[first].unrest * exp(best_unrest(&own));
        for (size_t k = first; k < end; k++) course[k].unrest = unrest;
    }
}

/* Level of the acceleration at which the prior of the unrest fits best if no variance changes: the harmonic mean of
 * these variances, and the level's own prior. The unrest is then that about this level. Step by step, both would creep
 * there. Newton's method; the function is convex. */
static void balance_unrest(const fo_work *w, const fo_prior *prior, double *level)
{
    enum { STEPS = 50 };
    const double mean = prior->mean[FO_L_acceleration], begin = *level;
    double rows = 0.0, calmness = 0.0;
    if (!(prior->std[FO_L_acceleration] > 0.0)) return;
    for (size_t n = 0; n < w->count; n++) {
        const fo_course *own = w->problem.course + w->parts[n].first;
        for (size_t k = 0; k < w->parts[n].rows; k++) calmness += 1.0 / own[k].unrest;
        rows += (double)w->parts[n].rows;
    }
    const double all = calm_rows * rows / (double)FO_STRETCH;
    for (int n = 0; n < STEPS; n++) {
        const double std = std_of(prior, FO_L_acceleration, *level - mean);
        const double ratio = calmness / rows * exp(2.0 * (*level - begin));
        const double slope = all * (ratio - 1.0) + (*level - mean) / (std * std);
        const double step = slope / (2.0 * all * fmax(ratio, 1.0) + 1.0 / (std * std));
        *level -= step;
        if (fabs(step) < 1e-6) break;
    }
    const double change = exp(2.0 * (begin - *level));
    for (size_t n = 0; n < w->count; n++) {
        fo_course *own = w->problem.course + w->parts[n].first;
        for (size_t k = 0; k < w->parts[n].rows; k++) own[k].unrest *= change;
    }
}

/* −ln of the prior of the unrest. */
static double unrest_penalty(const fo_course *course, size_t rows)
{
    double sum = 0.0;
    for (size_t k = 0; k < rows; k++)
        sum += (1.0 / course[k].unrest - 1.0 + log(course[k].unrest)) / (double)FO_STRETCH;
    return 0.5 * calm_rows * sum;
}

/* A row whose noise is this many times its variance, in both components together, is doubted: of a
 * million normal ones, 300 are. Its noise then has Student's distribution, with this many degrees of
 * freedom, so that a row that cannot be right counts for nothing. */
static const double doubted = 16.0, freedom = 4.0;

/* At most this share of the rows is doubted; if more of them do not fit, the level is wrong. */
static const double most_doubted = 0.1;

static void learn_doubt(const fo_squares *made, size_t rows, fo_course *course)
{
    double limit = doubted;
    for (;; limit *= 1.5) {
        size_t above = 0;
        for (size_t k = 0; k < rows; k++) above += made[k].noise * course[k].doubt > limit;
        if (!((double)above > most_doubted * (double)rows)) break;
    }
    for (size_t k = 0; k < rows; k++) {
        const double square = made[k].noise * course[k].doubt;
        course[k].doubt = square > limit ? (square + freedom) / (2.0 + freedom) : 1.0;
    }
}

/* −ln of the prior of the doubt. */
static double doubt_penalty(const fo_course *course, size_t rows)
{
    double sum = 0.0;
    for (size_t k = 0; k < rows; k++)
        if (course[k].doubt != 1.0) sum += 1.0 / course[k].doubt - 1.0 + log(course[k].doubt);
    return 0.5 * freedom * sum;
}

/* Last step of a parameter whose information is far from its curvature where the log hardly determines
 * it, and how long the next may be: logarithms of levels, and of a loss that is nearly zero, would
 * swing to and fro. A step that turns back is at most half of the last, the next four times as
 * long. Swings by a fiftieth do no harm; a smaller bound would hold a level that has rested and must
 * move. After a step that failed, the next is at most half as long. */
typedef struct {
    double last, most;
    bool failed;
} swing;

static const double harmless = 0.02;

static bool swings_too(int k)
{
    return is_level(k) || k == FO_L_loss || k == FO_L_mobility;
}

static double longest_swing(const swing *w, const fo_prior *prior, int k, double step)
{
    if (w->failed && is_level(k)) return 0.5 * fabs(w->last);
    if (w->last == 0.0) return longest(prior, k);
    if (step * w->last < 0.0) return fmax(0.5 * fabs(w->last), harmless);
    return fmin(4.0 * w->most, longest(prior, k));
}

/* Turns a scoring step into a step of ln std. The result is exact if all squares have one variance. */
static double of_variance(double step)
{
    return step < 0.5 ? -0.5 * log1p(-2.0 * step) : HUGE_VAL;
}

/* Steps with curvature H + μ D, the smallest μ (from `damping` on) with which none is longer than it may be:
 * D⁻¹ are the squares of the longest steps, which a swing shortens. With a μ relative to H, parameters that the log
 * hardly tells would take absurd values before those that are wrong have moved. The levels, on which the others
 * hardly depend, are shortened one by one; then those that go uphill alone, which others should have made up
 * for, stay. */
static bool trusted_steps(const selection *s, const fo_prior *prior, const double *g,
                          double H[MOST][MOST], double *damping, const swing *swings, double most[MOST],
                          double step[MOST])
{
    double R[MOST][MOST], scale[MOST], D[MOST];
    for (int k = 0; k < s->count; k++) {
        const double own = longest(prior, s->at[k]);
        D[k] = is_level(s->at[k]) ? 0.0 : 1.0 / (own * own);
    }
    for (; *damping <= largest_damping; *damping = fmax(3.0 * *damping, 0.01)) {
        if (!fo_factor(s->count, H, *damping, D, scale, R)) continue;
        fo_solve(s->count, R, scale, g, step);
        bool trusted = true, shortened = false;
        for (int k = 0; k < s->count; k++) {
            const int at = s->at[k];
            if (at == FO_L_noise || (is_level(at) && step[k] < 0.0)) step[k] = of_variance(step[k]);
            most[k] = swings_too(at) ? longest_swing(&swings[k], prior, at, step[k]) : longest(prior, at);
            if (is_level(at) && fabs(step[k]) > most[k]) {
                shortened = true;
                step[k] = copysign(most[k], step[k]);
            }
            trusted = trusted && fabs(step[k]) <= most[k];
        }
        for (int k = 0; k < s->count; k++)
            if (!is_level(s->at[k])) D[k] = 1.0 / (most[k] * most[k]);
        for (int k = 0; shortened && k < s->count; k++)
            if (is_level(s->at[k]) && g[k] * step[k] < 0.0) step[k] = 0.0;
        if (trusted) return true;
    }
    return false;
}

/* ln: closer, a level is right; it changes standard deviations only, and those by as much. Half squares: a level that
 * gains less is within what the log tells of it. */
static const double close_level = 0.1, hardly = 1.0;

/* Expected gain of a step of a parameter. */
static double gain_of(int k, double g, double step)
{
    const double gain = 0.5 * g * step;
    return is_level(k) && (fabs(step) < close_level || gain < hardly) ? 0.0 : gain;
}

/* Moves the parameters. Returns the expected gain; infinity if no step can be trusted. */
static double move(const selection *s, const fo_prior *prior, const double *g, double H[MOST][MOST],
                   double *damping, swing *swings, double *parameters)
{
    double step[MOST], most[MOST], gain = 0.0;
    if (!trusted_steps(s, prior, g, H, damping, swings, most, step)) return HUGE_VAL;
    for (int k = 0; k < s->count; k++) {
        swings[k] = (swing){step[k], most[k], false};
        parameters[s->at[k]] -= step[k];
        gain += gain_of(s->at[k], g[k], step[k]);
        if (s->round && s->at[k] == FO_L_L_d) parameters[FO_L_L_q] -= step[k];
    }
    parameters[FO_L_noise] = fmax(parameters[FO_L_noise], prior->mean[FO_L_noise] - quietest);
    return gain;
}

static double course_penalty(const fo_course *course, size_t rows)
{
    return unrest_penalty(course, rows) + doubt_penalty(course, rows);
}

/* Information, and where it was evaluated: it changes slowly, and costs more than the score. `known`: a step with it has
 * gained about what it should. */
typedef struct {
    double at[FO_UNKNOWNS], of[FO_UNKNOWNS * FO_UNKNOWNS];
    bool known;
} information;

/* A level, ln, may move so far until the information is evaluated again, and another parameter by this share of its
 * longest step, unless the log hardly tells it. Until then, a step is too long or too short, but no result changes: the
 * last covariance has its own. Assumed. */
static const double stale_level = 0.5, stale = 0.5;

static bool is_stale(const information *own, const fo_prior *prior, const double *parameters)
{
    if (!own->known) return true;
    for (int k = 0; k < FO_UNKNOWNS; k++) {
        const double moved = fabs(parameters[k] - own->at[k]);
        const bool told = own->of[k * FO_UNKNOWNS + k] * moved * moved > hardly;
        if (moved > (k < FO_VARIANCES ? stale_level : stale * longest(prior, k)) && told) return true;
    }
    return false;
}

/* A part of a log as a log. */
typedef struct {
    fo_log log;
    fo_problem problem;
    fo_filter *checkpoints;
} part;

static void part_of(const fo_work *w, size_t n, part *out)
{
    const fo_part *own = w->parts + n;
    out->log = fo_rows_of(w->problem.log, own->first, own->rows);
    out->problem = (fo_problem){&out->log, w->problem.machine, w->problem.start,
                                w->problem.course + own->first};
    out->checkpoints = w->checkpoints + own->first / FO_CHUNK + n;
}

/* Objective and information: the sum over the parts. */
static bool sum_innovations(const fo_work *w, const double *parameters, fo_detail detail,
                            fo_likelihood *sum)
{
    memset(sum, 0, sizeof *sum);
    for (size_t n = 0; n < w->count; n++) {
        part own;
        fo_likelihood at;
        part_of(w, n, &own);
        if (!fo_innovations(&own.problem, parameters, detail, &at, own.checkpoints)) return false;
        sum->objective += at.objective;
        sum->mean_square += at.mean_square * (double)at.counted;
        sum->counted += at.counted;
        for (int k = 0; k < FO_UNKNOWNS; k++) sum->score[k] += at.score[k];
        for (int k = 0; k < FO_UNKNOWNS * FO_UNKNOWNS; k++)
            sum->information[k] += at.information[k];
    }
    if (sum->counted) sum->mean_square /= (double)sum->counted;
    return true;
}

/* Adds up the score, and gives the next course and the squares. */
static void sum_backward(const fo_work *w, const double *parameters, bool smoothing, bool squares,
                         double *score)
{
    for (size_t n = 0; n < w->count; n++) {
        part own;
        part_of(w, n, &own);
        const fo_outputs wanted = {.course = smoothing ? own.problem.course : NULL,
                                   .squares = squares ? w->squares + w->parts[n].first : NULL};
        fo_backward(&own.problem, parameters, own.checkpoints, w->rows, &wanted, score);
    }
}

/* The information, as far as it is stale. False: the likelihood cannot be evaluated. */
static bool inform(const fo_work *w, const fo_prior *prior, const double *parameters, information *own,
                   fo_likelihood *at)
{
    if (is_stale(own, prior, parameters)) {
        if (!sum_innovations(w, parameters, FO_OF_ALL, at)) return false;
        memcpy(own->at, parameters, sizeof own->at);
        memcpy(own->of, at->information, sizeof own->of);
        own->known = true;
    }
    memcpy(at->information, own->of, sizeof own->of);
    return true;
}

static void save_course(const fo_work *w)
{
    memcpy(w->before, w->problem.course, w->problem.log->rows * sizeof *w->before);
}

static void restore_course(const fo_work *w)
{
    memcpy(w->problem.course, w->before, w->problem.log->rows * sizeof *w->before);
}

/* Takes half of the course's last step back: a Gauss–Newton step may be too long where the log hardly
 * tells the angle. */
static void halve_course(const fo_work *w)
{
    for (size_t k = 0; k < w->problem.log->rows; k++) {
        fo_course *own = w->problem.course + k;
        const fo_course *base = w->before + k;
        for (int a = 0; a < 2; a++) own->flux[a] = 0.5 * (own->flux[a] + base->flux[a]);
        own->angle = 0.5 * (own->angle + base->angle);
        own->psi = 0.5 * (own->psi + base->psi);
        own->unrest = sqrt(own->unrest * base->unrest);
        own->doubt = sqrt(own->doubt * base->doubt);
    }
}

/* Halvings of a step of the course, at most. */
enum { HALVINGS = 8 };

/* Trials of a step, until unrest and doubt are held responsible: the base is evaluated with the new ones. */
enum { TRIALS = 4 };

/* Half squares a row by which a step of the course may raise the objective. Assumed. */
static const double too_far = 0.1;

/* A step of the course, which is halved until the objective is no larger than this. */
static bool smooth_course(const fo_work *w, const double *parameters, double largest, fo_likelihood *at)
{
    save_course(w);
    sum_backward(w, parameters, true, false, NULL);
    for (int n = 0;; n++, halve_course(w)) {
        const bool good = sum_innovations(w, parameters, FO_OBJECTIVE, at) && isfinite(at->objective);
        if (n == HALVINGS || (good && at->objective <= largest)) return good;
    }
}

/* Of rows outside the parts, about which nothing is learnt. */
static const fo_squares usual_squares = {1.0, 0.0, 2.0};

/* Doubt, unrest and level of the acceleration, from the squares of the last evaluation. */
static void learn_course_levels(const fo_work *w, const fo_prior *prior, double *level)
{
    const fo_log *log = w->problem.log;
    learn_doubt(w->squares, log->rows, w->problem.course);
    learn_unrest(log, w->squares, w->problem.course);
    balance_unrest(w, prior, level);
}

bool fo_settle(const fo_work *w, const double *parameters, int passes)
{
    fo_likelihood at;
    if (!sum_innovations(w, parameters, FO_OBJECTIVE, &at)) return false;
    for (int n = 0; n < passes; n++)
        if (!smooth_course(w, parameters, at.objective + slack, &at)) break;
    return true;
}

bool fo_settle_unrest(const fo_work *w, const fo_prior *prior, int passes, double parameters[FO_UNKNOWNS])
{
    for (size_t k = 0; k < w->problem.log->rows; k++) w->squares[k] = usual_squares;
    for (int n = 0; n < passes; n++) {
        fo_likelihood at;
        if (!sum_innovations(w, parameters, FO_OBJECTIVE, &at)) return false;
        sum_backward(w, parameters, true, true, NULL);
        learn_course_levels(w, prior, parameters + FO_L_acceleration);
    }
    return true;
}

/* Steps of the course, at most, and the share of the rest that each must gain. Assumed. */
enum { FOLLOWING = 6 };
static const double enough = 0.5;

/* The objective at other parameters. The course follows them: about another, the objective is that of a linearisation
 * elsewhere. It goes on until the objective is no larger than `limit`, if it gets there. */
static bool evaluate_there(const fo_work *w, const double *parameters, double limit, fo_likelihood *at)
{
    if (!sum_innovations(w, parameters, FO_OBJECTIVE, at)) return false;
    const double far = too_far * (double)at->counted;
    for (int n = 0; n == 0 || (n < FOLLOWING && at->objective > limit); n++) {
        const double before = at->objective, rest = isfinite(limit) ? before - limit : 0.0;
        if (!smooth_course(w, parameters, fmax(limit, before + far), at)) return false;
        if (!(before - at->objective > fmax(enough * rest, far))) break;
    }
    return true;
}

/* Half squares a row that the last step may have gained if it was expected to gain nothing; if two steps were, they may
 * have gained more: such gains are those of the unrest, which hardly move anything else. Assumed. */
static const double little = 2e-4;

/* Learning ends if so many accepted steps have not gained what one should: levels that swing about their
 * values expect more than they gain. */
enum { IDLE = 4 };

/* The state of learning. `base`: parameters that were accepted, with gradient and curvature; `tried`: the next. */
typedef struct {
    const fo_work *w;
    const fo_prior *prior;
    selection free;
    information known;
    fo_likelihood at;
    double g[MOST], H[MOST][MOST], tried[FO_UNKNOWNS], damping, expected;
    swing swings[MOST];
    fo_posterior *base, best;
    bool based, small; /* small: the last step was expected to gain no more than it should */
    int failed, idle;
} learner;

/* Share of the expected gain from which on a step confirms the information (trust region). */
static const double as_expected = 0.25;

static void step(learner *l)
{
    l->expected = move(&l->free, l->prior, l->g, l->H, &l->damping, l->swings, l->tried);
}

static void set_failed(learner *l, bool failed)
{
    for (int k = 0; k < l->free.count; k++) l->swings[k].failed = failed;
}

/* The step was too long. After some trials, the next evaluates the base. */
static void shorten(learner *l)
{
    l->damping = fmax(10.0 * l->damping, 1.0);
    set_failed(l, true);
    restore_course(l->w);
    memcpy(l->tried, l->base->parameters, sizeof l->tried);
    if (++l->failed < TRIALS) step(l);
}

/* The trial becomes the base. False: its curvature is not finite. */
static bool accept(learner *l, double gain, bool first_steps)
{
    const fo_work *w = l->w;
    const size_t rows = w->problem.log->rows;
    fo_posterior *out = l->base;
    penalty own = penalty_at(l->prior, l->tried, out->harmonics);
    const double rest = course_penalty(w->problem.course, rows);
    double objective = l->at.objective + own.value + rest;
    const double gained = l->based ? out->objective - objective : HUGE_VAL;
    memcpy(out->parameters, l->tried, sizeof l->tried);
    out->mean_square = l->at.mean_square;
    const bool small = l->expected < gain;
    out->converged = small && (l->small || fabs(gained) < 10.0 * gain + little * (double)l->at.counted);
    l->small = small;
    if (!small && gained < as_expected * l->expected) l->known.known = false;
    l->failed = 0;
    l->idle = objective < l->best.objective - gain ? 0 : l->idle + 1;
    if (!inform(w, l->prior, l->tried, &l->known, &l->at)) return false;
    save_course(w);
    if (!out->converged) sum_backward(w, l->tried, true, true, l->at.score);
    reduced(&l->free, &l->at, &own, l->g, l->H);
    if (!invert(&l->free, l->H, out->covariance)) return false;
    /* The level moves once the first steps have removed what is not harmonic. */
    if (l->prior->harmonics > 0.0 && !first_steps) {
        out->harmonics = level(l->prior, out);
        own = penalty_at(l->prior, out->parameters, out->harmonics);
        objective = l->at.objective + own.value + rest;
        reduced(&l->free, &l->at, &own, l->g, l->H);
    }
    out->objective = objective;
    if (objective < l->best.objective) {
        l->best = *out;
        memcpy(w->best, w->before, rows * sizeof *w->best);
    }
    l->based = true;
    return true;
}

bool fo_learn_parts(const fo_work *w, const fo_prior *prior, double gain, size_t most, fo_posterior *out)
{
    const size_t rows = w->problem.log->rows;
    fo_course *course = w->problem.course;
    learner l = {.w = w, .prior = prior, .free = selected(prior), .expected = HUGE_VAL, .base = out, .best = *out};
    l.best.objective = HUGE_VAL;
    memcpy(l.tried, out->parameters, sizeof l.tried);
    out->converged = false;
    for (size_t k = 0; k < rows; k++) w->squares[k] = usual_squares;
    most += out->evaluations;
    for (size_t n = 0; out->evaluations < most; n++) {
        const bool same = l.based && !memcmp(l.tried, out->parameters, sizeof l.tried);
        const double rest = penalty_at(prior, l.tried, out->harmonics).value + course_penalty(course, rows);
        const double limit = l.based ? out->objective + slack - rest : -HUGE_VAL;
        const bool good = evaluate_there(w, l.tried, limit, &l.at);
        out->evaluations++;
        if (l.based && !same && !(good && l.at.objective <= limit)) {
            shorten(&l);
            continue;
        }
        if (!good && !l.based) return false;
        if (!good || !accept(&l, gain, n < 3) || out->converged || l.idle == IDLE) break;
        if (!w->held) {
            learn_course_levels(w, prior, out->parameters + FO_L_acceleration);
            l.tried[FO_L_acceleration] = out->parameters[FO_L_acceleration];
        }
        set_failed(&l, false);
        l.damping *= 0.1;
        step(&l);
    }
    if (out->converged) return true;
    if (!isfinite(l.best.objective)) return false;
    const size_t evaluations = out->evaluations;
    *out = l.best;
    out->evaluations = evaluations;
    out->converged = l.idle == IDLE; /* there is nothing more to gain */
    memcpy(course, w->best, rows * sizeof *course);
    return true;
}

bool fo_course_covariance(const fo_work *w, const fo_prior *prior, fo_posterior *out)
{
    fo_likelihood last;
    return sum_innovations(w, out->parameters, FO_OF_COURSE, &last) && fo_covariance(&last, prior, out);
}

bool fo_smooth_parts(const fo_work *w, const fo_prior *prior, fo_posterior *out, const fo_estimates *estimates)
{
    if (!fo_course_covariance(w, prior, out)) return false;
    for (size_t n = 0; n < w->count; n++) {
        part own;
        part_of(w, n, &own);
        const fo_outputs wanted = {.smoothed = estimates->rows + w->parts[n].first,
                                   .covariance = out->covariance,
                                   .shares = estimates->shares,
                                   .stride = estimates->stride,
                                   .place = w->parts[n].first};
        fo_backward(&own.problem, out->parameters, own.checkpoints, w->rows, &wanted, NULL);
    }
    return true;
}
