/* Compares parts of the adaptive observer with dense matrices in double. */
#include <stdio.h>
#include <stdlib.h>

#include "fluxobs_adaptive.c"
#include "fluxobs_fast.c"
#include "fluxobs_learning.c"

typedef double matrix[FO_NA][FO_NA];

static int failed;
static unsigned long seed = 1;

static double uniform(void) /* -1 to 1 */
{
    seed = (seed * 6364136223846793005UL + 1442695040888963407UL) & 0xFFFFFFFFFFFFFFFFUL;
    return (double)(seed >> 33) / 1073741824.0 - 1.0;
}

static void compare(const char *what, const double *a, const double *b, int n)
{
    const double most = sizeof(fo_real) == sizeof(float) ? 2e-4 : 1e-10;
    double off = 0.0, size = 0.0;
    for (int i = 0; i < n; i++) {
        off = fabs(a[i] - b[i]) > off ? fabs(a[i] - b[i]) : off;
        size = fabs(b[i]) > size ? fabs(b[i]) : size;
    }
    if (!(off <= most * size)) {
        printf("%s: off by %g of %g\n", what, off, size);
        failed = 1;
    }
}

/* Information U'dU of a factor of order n, from its first rows only. */
static void expand(int n, int rows, const fo_real U[], const fo_real d[], double *info)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            info[i * n + j] = 0.0;
            for (int k = 0; k < rows && k <= i && k <= j; k++) {
                const double a = k == i ? 1.0 : (double)U[FO_AT(n, k, i)];
                const double b = k == j ? 1.0 : (double)U[FO_AT(n, k, j)];
                info[i * n + j] += a * b * (double)d[k];
            }
        }
    }
}

/* Inverse by the method of Gauss and Jordan with pivots. */
static void invert(int n, const double *given, double *inverse)
{
    double a[FO_NA * FO_NA];
    memcpy(a, given, sizeof(double) * (size_t)(n * n));
    for (int i = 0; i < n * n; i++) {
        inverse[i] = i % (n + 1) == 0 ? 1.0 : 0.0;
    }
    for (int c = 0; c < n; c++) {
        int p = c;
        for (int r = c + 1; r < n; r++) {
            p = fabs(a[r * n + c]) > fabs(a[p * n + c]) ? r : p;
        }
        for (int j = 0; j < n; j++) {
            double keep = a[c * n + j];
            a[c * n + j] = a[p * n + j];
            a[p * n + j] = keep;
            keep = inverse[c * n + j];
            inverse[c * n + j] = inverse[p * n + j];
            inverse[p * n + j] = keep;
        }
        const double over = 1.0 / a[c * n + c];
        for (int j = 0; j < n; j++) {
            a[c * n + j] *= over;
            inverse[c * n + j] *= over;
        }
        for (int r = 0; r < n; r++) {
            const double by = a[r * n + c];
            for (int j = 0; r != c && j < n; j++) {
                a[r * n + j] -= by * a[c * n + j];
                inverse[r * n + j] -= by * inverse[c * n + j];
            }
        }
    }
}

static void random_triangle(int n, fo_real U[], fo_real d[], fo_real z[])
{
    for (int i = 0; i < n * (n - 1) / 2; i++) {
        U[i] = (fo_real)(0.5 * uniform());
    }
    for (int i = 0; i < n; i++) {
        d[i] = (fo_real)(1.0 + 0.5 * uniform());
        z[i] = (fo_real)uniform();
    }
}

/* A row that is added to the factor adds its outer product to the information, and its value to the
 * right-hand side. The row that remains after the first rows is the row for the other unknowns
 * after elimination of the first unknowns. */
static void check_rotation(void)
{
    enum { N = 7, M = 3 };
    fo_real U[FO_PACKED(N)], d[N], z[N], row[N], x[N], value = (fo_real)0.7;
    fo_real information = (fo_real)1.3;
    double before[N * N], after[N * N], all[N * N], given[N], rhs[N], solved[N], sought[N];
    random_triangle(N, U, d, z);
    expand(N, N, U, d, before);
    for (int i = 0; i < N; i++) { /* U'd z */
        rhs[i] = 0.0;
        for (int k = 0; k <= i; k++) {
            rhs[i] += (k == i ? 1.0 : (double)U[FO_AT(N, k, i)]) * (double)d[k] * (double)z[k];
        }
    }
    for (int i = 0; i < N; i++) {
        row[i] = i == 2 ? ZERO : (fo_real)uniform(); /* zeros are skipped */
        given[i] = (double)row[i];
        rhs[i] += 1.3 * given[i] * 0.7;
    }
    fo_add_row_to(N, U, d, z, 0, M, row, &value, &information);
    expand(N, N, U, d, after);
    for (int i = 0; i < N; i++) { /* rotated rows, and the remaining row */
        for (int j = 0; j < N; j++) {
            all[i * N + j] = before[i * N + j] + 1.3 * given[i] * given[j];
            after[i * N + j] += (double)information * (double)row[i] * (double)row[j];
        }
    }
    compare("rotation, half way", after, all, N * N);
    for (int i = 0; i < M; i++) {
        if (row[i] != ZERO) {
            printf("rotation: the row is not zero at %d\n", i);
            failed = 1;
        }
    }
    fo_add_row_to(N, U, d, z, M, N, row, &value, &information);
    expand(N, N, U, d, after);
    compare("rotation", after, all, N * N);
    fo_solve(N, U, z, 0, N, x);
    double inverse[N * N];
    invert(N, all, inverse);
    for (int i = 0; i < N; i++) {
        solved[i] = (double)x[i];
        sought[i] = 0.0;
        for (int j = 0; j < N; j++) {
            sought[i] += inverse[i * N + j] * rhs[j];
        }
    }
    compare("solution", solved, sought, N);
    fo_real direction[N];
    double variance = 0.0;
    for (int i = 0; i < N; i++) {
        direction[i] = (fo_real)given[i];
        for (int j = 0; j < N; j++) {
            variance += given[i] * inverse[i * N + j] * given[j];
        }
    }
    double found = (double)fo_marginal_variance(N, U, d, 0, M, direction);
    found += (double)fo_marginal_variance(N, U, d, M, N, direction);
    compare("variance", &found, &variance, 1);
}

/* A random step of the flux adds its variance to the covariance of the flux. */
static void check_step_flux(void)
{
    fo_learner s;
    static double before[FO_NA * FO_NA], P[FO_NA * FO_NA], after[FO_NA * FO_NA], Q[FO_NA * FO_NA];
    memset(&s, 0, sizeof s);
    random_triangle(FO_NA, s.U, s.d, s.z);
    expand(FO_NA, FO_NA, s.U, s.d, before);
    invert(FO_NA, before, P);
    P[0] += 0.4;
    P[FO_NA + 1] += 0.4;
    add_flux_process_noise(&s, (fo_real)0.4);
    expand(FO_NA, FO_NA, s.U, s.d, after);
    invert(FO_NA, after, Q);
    compare("step of the flux", Q, P, FO_NA * FO_NA);
}

/* The transition to the end of a block: P <- F P F'. */
static void check_propagation(void)
{
    static fo_adaptive a;
    fo_learner s;
    fo_block b;
    static double info[FO_NA * FO_NA], P[FO_NA * FO_NA], F[FO_NA * FO_NA], Q[FO_NA * FO_NA];
    static double sought[FO_NA * FO_NA];
    memset(&s, 0, sizeof s);
    memset(&b, 0, sizeof b);
    memset(F, 0, sizeof F);
    random_triangle(FO_NA, s.U, s.d, s.z);
    b.time = (fo_real)0.3;
    for (int j = 0; j < FO_NP; j++) {
        a.std[j] = (fo_real)(0.2 + 0.1 * uniform());
    }
    for (int i = 0; i < FO_NA; i++) {
        F[i * FO_NA + i] = 1.0;
    }
    for (int i = 0; i < FO_N; i++) {
        F[i * FO_NA + FO_N + i] = (double)b.time;
        for (int j = 0; j < FO_NS; j++) {
            b.sensitivity[j][i] = (fo_real)uniform();
            F[i * FO_NA + FO_NF + FO_RESISTANCE + j] =
                (double)(a.std[FO_RESISTANCE + j] * b.sensitivity[j][i]);
        }
    }
    expand(FO_NA, FO_NA, s.U, s.d, info);
    invert(FO_NA, info, P);
    for (int i = 0; i < FO_NA; i++) {
        for (int j = 0; j < FO_NA; j++) {
            sought[i * FO_NA + j] = 0.0;
            for (int k = 0; k < FO_NA; k++) {
                for (int l = 0; l < FO_NA; l++) {
                    sought[i * FO_NA + j] += F[i * FO_NA + k] * P[k * FO_NA + l] * F[j * FO_NA + l];
                }
            }
        }
    }
    propagate(&a, &s, &b);
    expand(FO_NA, FO_NA, s.U, s.d, info);
    invert(FO_NA, info, Q);
    compare("transition", Q, sought, FO_NA * FO_NA);
}

static void simple(fo_adaptive *a)
{
    memset(a, 0, sizeof *a);
    a->plain.h = (fo_real)0.01;
    a->plain.sample_time = (fo_real)1e-4;
    a->plain.L_position = (fo_real)0.05;
    a->psi = ONE;
    a->over_current[0] = ONE;
    a->over_current[1] = (fo_real)0.2;
    a->over_rated = (fo_real)0.05;
    a->volt = (fo_real)0.01;
    for (int j = 0; j < FO_NP; j++) {
        a->std[j] = (fo_real)(0.2 + 0.1 * uniform());
    }
}

/* The derivatives of a sample's residual must equal difference quotients. */
static void check_derivatives(void)
{
    static fo_adaptive a;
    static fo_adaptive_state s;
    simple(&a);
    a.saliency = (fo_real)-0.03;
    memset(&s, 0, sizeof s);
    s.flux[0] = (fo_real)0.8;
    s.flux[1] = (fo_real)0.7;
    s.plain.current[0][0] = (fo_real)2.5;
    s.plain.current[0][1] = (fo_real)-1.5;
    const double step = sizeof(fo_real) == sizeof(float) ? 2e-2 : 1e-5;
    for (int n = 0; n < FO_N + FO_NP; n++) {
        double two[2], derivative = 0.0;
        for (int side = 0; side < 2; side++) {
            fo_adaptive_state t = s;
            fo_linearisation at;
            const fo_real by = (fo_real)(side == 0 ? -step : step);
            if (n < FO_N) {
                t.flux[n] += by;
            } else {
                t.value[n - FO_N] += by;
            }
            fo_linearise(&a, t.value, t.flux, t.plain.current[0], &t.map_point, &at);
            add_sample(&a, &t, &t.map_point, &at);
            const fo_sums *sums = &t.now.sums;
            two[side] = (double)sums->residual[0];
            derivative += 0.5 * (double)(n < FO_N ? sums->h[n]
                                         : n == FO_N ? -ONE
                                                     : sums->by_parameter[n - FO_N - 1][0]);
        }
        const double found = (two[1] - two[0]) / (2.0 * step);
        if (!(fabs(found - derivative) < 2e-3 * (1.0 + fabs(found)))) {
            printf("derivative %d: %g, is %g\n", n, derivative, found);
            failed = 1;
        }
    }
}

/* Moving the sums to a correction must give the residuals of the corrected flux and parameters. The
 * rows of a block must have the information of all its samples about a constant flux error. */
static void check_block_rows(void)
{
    static fo_adaptive a;
    static fo_adaptive_state s, t;
    static fo_answer c;
    block_rows r;
    simple(&a);
    memset(&s, 0, sizeof s);
    memset(&c, 0, sizeof c);
    const int samples = 40;
    double info[3] = {0.0, 0.0, 0.0}, rhs[FO_N] = {0.0, 0.0};
    const double turned = 5.0, step = sizeof(fo_real) == sizeof(float) ? 1e-3 : 1e-6;
    c.flux[0] = (fo_real)step;
    c.change[FO_PSI] = (fo_real)(-0.5 * step);
    c.value[FO_PSI] = c.change[FO_PSI];
    t = s;
    t.value[FO_PSI] = c.value[FO_PSI];
    for (int k = 0; k < samples; k++) {
        const double angle = turned * k / samples, error = 1e-3 * uniform();
        fo_linearisation at;
        s.block.time = t.block.time = (fo_real)(0.01 * k);
        for (int i = 0; i < FO_N; i++) {
            s.flux[i] = (fo_real)((1.0 + error) * (i == 0 ? cos(angle) : sin(angle)));
            t.flux[i] = s.flux[i] + c.flux[i];
        }
        fo_linearise(&a, s.value, s.flux, s.plain.current[0], &s.map_point, &at);
        add_sample(&a, &s, &s.map_point, &at);
        const double h[FO_N] = {cos(angle), sin(angle)};
        info[0] += h[0] * h[0];
        info[1] += h[0] * h[1];
        info[2] += h[1] * h[1];
        rhs[0] -= h[0] * error;
        rhs[1] -= h[1] * error;
        fo_linearise(&a, t.value, t.flux, t.plain.current[0], &t.map_point, &at);
        add_sample(&a, &t, &t.map_point, &at);
    }
    sum_rows(&a, &s.block, &s.now.sums, &r);
    decorrelate(&s.now.sums, &r);
    double found[3] = {0.0, 0.0, 0.0}, found_rhs[FO_N] = {0.0, 0.0};
    for (int w = 0; w < FO_NW; w++) {
        const double weight = samples * (double)r.share[w];
        found[0] += weight * (double)(r.row[w][0] * r.row[w][0]);
        found[1] += weight * (double)(r.row[w][0] * r.row[w][1]);
        found[2] += weight * (double)(r.row[w][1] * r.row[w][1]);
        found_rhs[0] += weight * (double)(r.row[w][0] * r.innovation[w]);
        found_rhs[1] += weight * (double)(r.row[w][1] * r.innovation[w]);
    }
    compare("information of a block", found, info, 3);
    const double far = fabs(found_rhs[0] - rhs[0]) + fabs(found_rhs[1] - rhs[1]);
    if (!(far < (sizeof(fo_real) == sizeof(float) ? 1e-4 : 1e-9))) {
        printf("rows of a block: right-hand side off by %g\n", far);
        failed = 1;
    }
    correct_residuals(&s.now.sums, &c);
    for (int w = 0; w < FO_NW; w++) { /* to first order in the correction */
        const double off = fabs((double)(s.now.sums.residual[w] - t.now.sums.residual[w]));
        if (!(off < 1e-2 * samples * step)) {
            printf("corrected residual %d: off by %g\n", w, off);
            failed = 1;
        }
    }
}

/* The sensitivities of an interval's volt-seconds must equal difference quotients by each
 * parameter. */
static void check_sensitivities(void)
{
    static fo_adaptive a;
    static fo_adaptive_state s;
    simple(&a);
    memset(&s, 0, sizeof s);
    a.inverter_mean = (fo_real)0.4;
    a.plain.current_limit = (fo_real)100;
    s.sample_index = 3U; /* the turn in which the signs and their gradient are updated */
    const fo_real i[FO_N] = {(fo_real)1.2, (fo_real)-0.7}, u[FO_N] = {(fo_real)3, (fo_real)-5};
    for (int k = 0; k < FO_HISTORY; k++) {
        s.plain.current[k][0] = i[0];
        s.plain.current[k][1] = i[1];
    }
    s.plain.have_current = true;
    const double step = sizeof(fo_real) == sizeof(float) ? 1e-2 : 1e-5;
    for (int j = 0; j < (int)FO_NS; j++) {
        double found[FO_N], effect[FO_N] = {0.0, 0.0};
        for (int side = 0; side < 2; side++) {
            fo_adaptive_state t = s;
            fo_real mean[FO_N], lost[FO_N], left[FO_N];
            t.value[FO_RESISTANCE + j] += (fo_real)(side == 0 ? -step : step);
            predicted_loss(&a, &t, i, mean, lost);
            correct_asymmetry(&t, u, left);
            for (int n = 0; n < FO_N; n++) { /* like the plain observer */
                t.plain.source[n] = a.volt * (left[n] - lost[n]);
                found[n] = side == 0 ? -(double)t.plain.source[n]
                                     : (found[n] + (double)t.plain.source[n]) / (2.0 * step);
            }
            t.plain.source[0] = a.volt * u[0]; /* computed with the measured voltage */
            t.plain.source[1] = a.volt * u[1];
            add_sensitivities(&a, &t, false, mean);
            effect[0] += 0.5 * (double)t.block.sensitivity[j][0];
            effect[1] += 0.5 * (double)t.block.sensitivity[j][1];
        }
        for (int n = 0; n < FO_N; n++) {
            if (!(fabs(found[n] - effect[n]) < 2e-3 * (1e-3 + fabs(found[n])))) {
                printf("sensitivity %d: %g, is %g\n", j, effect[n], found[n]);
                failed = 1;
            }
        }
    }
}

/* No inverter adds voltage: the estimate must be the most likely one with a loss of zero. */
static void check_no_gain(void)
{
    static fo_adaptive a;
    fo_learner s;
    fo_real row[FO_NA] = {ZERO};
    simple(&a);
    memset(&s, 0, sizeof s);
    a.plain.hR[0][0] = a.volt * (fo_real)(2.0 / 24.0); /* two ohms */
    fo_learning_reset(&a, &s);
    row[FO_NF + FO_INVERTER] = ONE;
    row[FO_NF + FO_RESISTANCE] = (fo_real)0.5;
    update_parameters(&a, &s, row, -ONE, (fo_real)3);
    const double volts = (double)(a.std[FO_INVERTER] * s.p[FO_INVERTER] +
                                  a.std[FO_INVERTER + 1] * s.p[FO_INVERTER + 1]);
    if (!(fabs(volts) < 1e-4 && s.p[FO_RESISTANCE] < ZERO)) {
        printf("inverter: gains %g V\n", -volts);
        failed = 1;
    }
    memset(row, 0, sizeof row);
    row[FO_NF + FO_RESISTANCE] = ONE;
    update_parameters(&a, &s, row, (fo_real)-1e3, (fo_real)10);
    const double ohms = 2.0 + (double)(a.std[FO_RESISTANCE] * s.p[FO_RESISTANCE]);
    if (!(fabs(ohms) < 1e-3)) {
        printf("resistance: %g ohms instead of none\n", ohms);
        failed = 1;
    }
}

/* The cost of a candidate, directly from its definition. */
static double cost_of(const fo_information *info, const double p[FO_NM], double noise)
{
    const double x[FO_NX] = {p[0] * p[0] + p[1] * p[1] - p[4], p[0], p[1],
                             2 * (p[0] * p[2] + p[1] * p[3]), p[2], p[3],
                             p[2] * p[2] + p[3] * p[3]};
    double cost = 0.0;
    int u = 0;
    for (int i = 0; i < FO_NX; i++) {
        double off = (double)info->z[i] - x[i];
        for (int j = i + 1; j < FO_NX; j++) {
            off -= (double)info->U[u] * x[j];
            u++;
        }
        cost += (double)info->d[i] * off * off;
    }
    return cost - noise * p[4];
}

static void check_projection(void)
{
    static fo_adaptive a;
    static fo_learner s;
    static fo_mail mail;
    fo_manifold m;
    fo_candidate c;
    memset(&a, 0, sizeof a);
    memset(&s, 0, sizeof s);
    memset(&mail, 0, sizeof mail);
    memset(&c, 0, sizeof c);
    mail.data.search.direction[0] = ONE;
    a.psi = ONE;
    a.std[FO_PSI] = (fo_real)1e3; /* the prior is negligible */
    fo_information *info = &mail.data.search.info;
    for (int i = 0; i < FO_TRIANGLE; i++) {
        info->U[i] = (fo_real)(0.3 * uniform());
    }
    const double x[FO_NX] = {0.05, 0.8, -0.6, 0.1, 0.07, -0.02, 0.004};
    int u = 0;
    for (int i = 0; i < FO_NX; i++) {
        double z = x[i];
        for (int j = i + 1; j < FO_NX; j++) {
            z += (double)info->U[u] * x[j];
            u++;
        }
        info->z[i] = (fo_real)z;
        info->d[i] = (fo_real)(50.0 + 20.0 * uniform());
    }
    info->noise[0] = (fo_real)2;
    c.p[0] = (fo_real)0.8;
    c.p[1] = (fo_real)-0.6;
    c.p[4] = ONE;
    for (int k = 0; k < 60; k++) {
        fo_gauss_newton_step(&a, &s, &mail, &c, &m);
    }
    double p[FO_NM];
    for (int i = 0; i < FO_NM; i++) {
        p[i] = (double)c.p[i];
    }
    const double here = cost_of(info, p, 2.0);
    for (int i = 0; i < FO_NM; i++) { /* at the minimum, the cost rises in both directions */
        for (int side = -1; side <= 1; side += 2) {
            double q[FO_NM];
            memcpy(q, p, sizeof q);
            q[i] += side * 0.01;
            if (!(cost_of(info, q, 2.0) > here)) {
                printf("projection: not the least along %d\n", i);
                failed = 1;
            }
        }
    }
    const double said = (double)c.cost;
    const double close = fabs(said - here) < 1e-3 * fabs(here) + 1e-4;
    if (!close) {
        printf("projection: cost %g, is %g\n", said, here);
        failed = 1;
    }
}

/* Covariance of the flux, given drift and parameters, from the first two rows of the factor. */
static void conditional(const fo_learner *s, double P[3])
{
    const double u = (double)s->U[0], d0 = (double)s->d[0], d1 = (double)s->d[1];
    P[0] = 1.0 / d0 + u * u / d1;
    P[1] = -u / d1;
    P[2] = 1.0 / d1;
}

/* A start has the projection's information on flux and drift. The start ties an error of the
 * resistance to the flux as in steady state: the flux of the true resistance is equally likely. */
static void check_start(void)
{
    static fo_adaptive a;
    static fo_learner s;
    fo_manifold m;
    fo_candidate c;
    fo_block_end t;
    simple(&a);
    a.plain.drift_prior_std = ONE;
    memset(&s, 0, sizeof s);
    memset(&c, 0, sizeof c);
    memset(&m, 0, sizeof m);
    memset(&t, 0, sizeof t);
    fo_learning_reset(&a, &s);
    t.speed = (fo_real)300;
    random_triangle(FO_NM, m.U, m.d, m.z);
    c.p[0] = ONE;
    c.p[4] = (fo_real)1.44;
    t.mean_current[1] = (fo_real)0.02 / (a.std[FO_RESISTANCE] * a.volt);
    fo_learning_start(&a, &s, &c, &m, (fo_real)2, &t);
    static double found[FO_NA * FO_NA], given[FO_NM * FO_NM];
    expand(FO_NA, FO_NF, s.U, s.d, found);
    expand(FO_NM, FO_NF, m.U, m.d, given);
    double two[FO_NF * FO_NF], one[FO_NF * FO_NF];
    for (int i = 0; i < FO_NF * FO_NF; i++) {
        two[i] = found[i / FO_NF * FO_NA + i % FO_NF];
        one[i] = given[i / FO_NF * FO_NM + i % FO_NF] / 2.0;
    }
    compare("start, information", two, one, FO_NF * FO_NF);
    /* the resistive drop of one std along -beta, at 0.03 rad a sample, moves the flux along -alpha
     * by 2/3 */
    const double along = -0.02 / 0.03;
    double x[FO_NA] = {0.0}, cost = 0.0;
    x[0] = along;
    x[FO_NF + FO_RESISTANCE] = 1.0;
    x[FO_NF + FO_PSI] = along / (double)a.std[FO_PSI]; /* the flux is shorter by the same amount  */
    for (int i = 0; i < FO_NA; i++) {
        for (int j = 0; j < FO_NA; j++) {
            cost += x[i] * found[i * FO_NA + j] * x[j];
        }
    }
    if (!(fabs(cost) < 1e-6)) {
        printf("start: a wrong resistance costs %g\n", cost);
        failed = 1;
    }
    /* the parameter-to-EMF ratio adds 0.3 ratio^2 length^2 to the variance of the flux; the
     * voltage's variance is added to that of the drift in the same way */
    double before[3], after[3];
    conditional(&s, before);
    const double tight = 1.0 / (double)s.d[FO_N];
    t.emf_ratio = (fo_real)0.5;
    s.report.voltage_std = (fo_real)0.002 / a.plain.h;
    fo_learning_start(&a, &s, &c, &m, (fo_real)2, &t);
    conditional(&s, after);
    const double wide[3] = {before[0] + 0.3 * 0.25, before[1], before[2] + 0.3 * 0.25};
    compare("start, doubt of the flux", after, wide, 3);
    const double turning = (double)s.report.voltage_std;
    const double loose = 1.0 / (double)s.d[FO_N], due = tight + 0.3 * turning * turning;
    compare("start, doubt of the drift", &loose, &due, 1);
}

/* The tracker must find angle and speed from any start. At some speeds the errors of a few samples
 * cancel, and a plain filter would keep such a speed. */
static void check_tracker(void)
{
    static fo_observer o;
    const double h = 1e-4, pole = 0.94, gap = 1.0 - pole, turn_by = 0.03 * (1.0 + uniform());
    o.sample_time = (fo_real)h;
    o.track[0] = (fo_real)(1.0 - pole * pole * pole);
    o.track[1] = (fo_real)(1.5 * gap * gap * (1.0 + pole) / h);
    o.track[2] = (fo_real)(gap * gap * gap / (h * h));
    double speed = (double)PI / h * uniform(), angle = (double)PI * uniform();
    fo_tracker t = {ZERO, (fo_real)speed, ZERO, ZERO, false};
    for (int k = 0; k < 1000; k++) {
        angle = remainder(angle + turn_by, 2.0 * (double)PI);
        track(&o, &t, (fo_real)angle);
    }
    const double off = fabs(remainder((double)t.angle - angle, 2.0 * (double)PI));
    if (!(off < 1e-4 && fabs((double)t.speed * h - turn_by) < 1e-4)) { /* single: rounding */
        printf("tracker: off by %g rad, and by %g of %g rad a sample\n", off,
               fabs((double)t.speed * h - turn_by), turn_by);
        failed = 1;
    }
}

static void demand_that(bool good, const char *what, double at)
{
    if (!good) {
        printf("%s at %.17g\n", what, at);
        failed = 1;
    }
}

/* Elementary functions must be as exact as their comments state. */
static void check_functions(void)
{
    const double rounding = sizeof(fo_real) == sizeof(float) ? 4e-7 : 0.0;
    for (int n = -4000; n <= 4000; n++) {
        const double x = n / 500.0; /* -8 to 8 */
        const fo_real y = (fo_real)x;
        const double most = fabs(x) <= 1.0 ? 1e-6 : 0.00141;
        demand_that(fabs((double)soft_sign(y) - tanh(x)) < most, "soft_sign", x);
        if (fabs(x) <= (double)PI) {
            fo_real at[2];
            fo_direction(y, at);
            demand_that(fabs((double)at[0] - cos(x)) < 5e-9 + rounding, "cosine", x);
            demand_that(fabs((double)at[1] - sin(x)) < 5e-9 + rounding, "sine", x);
        }
        if (fabs(x) < 1.5) {
            const fo_real v[FO_N] = {(fo_real)0.6, (fo_real)-0.8};
            fo_real turned[FO_N];
            turn(v, y, turned);
            const double off = hypot((double)turned[0] - 0.6 * cos(x) - 0.8 * sin(x),
                                     (double)turned[1] + 0.8 * cos(x) - 0.6 * sin(x));
            demand_that(off <= 1e-3 * fabs(x) + rounding, "turn", x);
        }
    }
    demand_that(wrap(PI) == PI, "wrap", (double)PI);
    demand_that(wrap(-PI) == PI, "wrap", -(double)PI);
    demand_that(fabs((double)wrap((fo_real)4) - 4.0 + 2.0 * (double)PI) < 1e-6, "wrap", 4.0);
    demand_that(fabs((double)wrap((fo_real)-4) + 4.0 - 2.0 * (double)PI) < 1e-6, "wrap", -4.0);
    /* the mean of t^k from -1 to 0, from samples at 0, -1, -2, -3 */
    for (int k = 0; k <= 3; k++) {
        const double mean = pow(-1.0, k) / (k + 1);
        const fo_real found = mean_current_24((fo_real)pow(0.0, k), (fo_real)pow(-1.0, k),
                                              (fo_real)pow(-2.0, k), (fo_real)pow(-3.0, k));
        demand_that(fabs((double)found - 24.0 * mean) < 1e-5, "mean current of power", k);
    }
    demand_that(correlation((fo_real)0.5, TWO) == (fo_real)0.25, "correlation", 0.25);
    demand_that(correlation(-ONE, TWO) == ZERO, "correlation", -0.5);
    demand_that(correlation(ONE, ZERO) == ZERO, "correlation without power", 0.0);
    demand_that(correlation(TWO, TWO) == (fo_real)0.98, "correlation", 1.0);
}

/* Lost voltage: vector of the signs of the phases, and its derivative. */
static void check_soft_signs(void)
{
    const double root = sqrt(3.0) / 2.0, over = 0.8, volts = 1.7;
    const double axes[3][2] = {{1.0, 0.0}, {-0.5, root}, {-0.5, -root}};
    for (int n = 0; n < 12; n++) {
        const double angle = 0.1 + n * (double)PI / 6.0, i[2] = {2 * cos(angle), 2 * sin(angle)};
        fo_real phase[3], sign_of[3], signs[FO_N], bend[3] = {ZERO, ZERO, ZERO};
        double sum[2] = {0.0, 0.0}, slope[3] = {0.0, 0.0, 0.0};
        for (int k = 0; k < 3; k++) {
            phase[k] = (fo_real)(axes[k][0] * i[0] + axes[k][1] * i[1]);
        }
        soft_signs(phase, (fo_real)over, sign_of, signs);
        add_sign_gradient(sign_of, (fo_real)(volts * over), bend);
        for (int k = 0; k < 3; k++) {
            const double sign = tanh(over * (axes[k][0] * i[0] + axes[k][1] * i[1]));
            const double steep = volts * over * (1.0 - sign * sign);
            for (int m = 0; m < 2; m++) {
                sum[m] += 2.0 / 3.0 * sign * axes[k][m];
                slope[2 * m] += 2.0 / 3.0 * steep * axes[k][m] * axes[k][m];
            }
            slope[1] += 2.0 / 3.0 * steep * axes[k][0] * axes[k][1];
        }
        for (int m = 0; m < 2; m++) {
            demand_that(fabs((double)signs[m] - sum[m]) < 0.003, "signs", angle);
        }
        for (int m = 0; m < 3; m++) {
            demand_that(fabs((double)bend[m] - slope[m]) < 0.01, "bend", angle);
        }
    }
}

/* A tracker has settled if its error was small for a tenth of the memory. While the error is
 * larger, a thirtieth of the time counts. A small error is within 3 degrees and three standard
 * deviations. */
static void check_settling(void)
{
    static fo_observer o;
    o.h = (fo_real)0.03;
    const double limit = (double)PI / 60.0 + 0.3;
    fo_tracker t = {(fo_real)1, ZERO, ZERO, ZERO, false};
    settle_tracker(&o, &t, (fo_real)(1.0 + limit - 1e-5), (fo_real)0.1);
    demand_that(t.settled == o.h, "near", limit);
    settle_tracker(&o, &t, (fo_real)(1.0 - limit - 1e-5), (fo_real)0.1);
    demand_that(fabs((double)t.settled - 0.031) < 1e-7, "not near", limit);
    t.settled = (fo_real)0.1;
    settle_tracker(&o, &t, ONE, ZERO);
    demand_that(t.settled == (fo_real)0.1, "settled", 0.1);
}

int main(void)
{
    check_functions();
    check_soft_signs();
    check_settling();
    for (int times = 0; times < 20; times++) {
        check_rotation();
        check_step_flux();
        check_propagation();
        check_derivatives();
        check_block_rows();
        check_sensitivities();
        check_no_gain();
        check_projection();
        check_start();
        for (int starts = 0; starts < 50; starts++) {
            check_tracker();
        }
    }
    return failed;
}
