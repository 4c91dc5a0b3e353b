/* The pieces of the adaptive observer against dense matrices in double. */
#include <stdio.h>
#include <stdlib.h>

#include "fluxobs_adaptive.c"

typedef double matrix[FO_NP][FO_NP];

static int failed;
static unsigned long seed = 1;

static double uniform(void) /* -1 to 1 */
{
    seed = (seed * 6364136223846793005UL + 1442695040888963407UL) & 0xFFFFFFFFFFFFFFFFUL;
    return (double)(seed >> 33) / 1073741824.0 - 1.0;
}

static void expand(const fo_adaptive_state *s, matrix P)
{
    for (int i = 0; i < FO_NP; i++) {
        for (int j = 0; j < FO_NP; j++) {
            P[i][j] = 0.0;
            for (int k = i > j ? i : j; k < FO_NP; k++) {
                const double a = k == i ? 1.0 : (double)s->U[AT(i, k)];
                const double b = k == j ? 1.0 : (double)s->U[AT(j, k)];
                P[i][j] += a * b * (double)s->D[k];
            }
        }
    }
}

static void compare(const char *what, const double *a, const double *b, int n)
{
    const double most = sizeof(fo_real) == sizeof(float) ? 2e-4 : 1e-11;
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

static void random_state(fo_adaptive_state *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < FO_NP_TRIANGLE; i++) {
        s->U[i] = (fo_real)uniform();
    }
    for (int i = 0; i < FO_NP; i++) {
        s->D[i] = (fo_real)(0.1 + fabs(uniform()));
        s->p[i] = (fo_real)uniform();
    }
    s->level = ONE;
    s->power = ONE;
}

static void check_update(void)
{
    fo_adaptive_state s;
    matrix P, Q, found;
    fo_real row[FO_NP];
    double Pg[FO_NP], g[FO_NP], p[FO_NP], moved[FO_NP], alpha = 0.3;
    random_state(&s);
    expand(&s, P);
    for (int i = 0; i < FO_NP; i++) {
        row[i] = (fo_real)uniform();
        g[i] = (double)row[i];
    }
    for (int i = 0; i < FO_NP; i++) {
        Pg[i] = 0.0;
        for (int j = 0; j < FO_NP; j++) {
            Pg[i] += P[i][j] * g[j];
        }
    }
    for (int i = 0; i < FO_NP; i++) {
        alpha += g[i] * Pg[i];
    }
    for (int i = 0; i < FO_NP; i++) {
        p[i] = (double)s.p[i] + Pg[i] * 0.7 / alpha;
        for (int j = 0; j < FO_NP; j++) {
            Q[i][j] = P[i][j] - Pg[i] * Pg[j] / alpha;
        }
    }
    const double said = (double)update(&s, row, (fo_real)0.7, (fo_real)0.3);
    expand(&s, found);
    for (int i = 0; i < FO_NP; i++) {
        moved[i] = (double)s.p[i];
    }
    compare("update, covariance", &found[0][0], &Q[0][0], FO_NP * FO_NP);
    compare("update, estimate", moved, p, FO_NP);
    compare("update, innovation", &said, &alpha, 1);
}

static void check_widen(void)
{
    for (int n = 0; n < FO_NP; n++) {
        fo_adaptive_state s;
        matrix P, found;
        random_state(&s);
        expand(&s, P);
        P[n][n] += 0.4;
        widen(&s, n, (fo_real)0.4);
        expand(&s, found);
        compare("widen", &found[0][0], &P[0][0], FO_NP * FO_NP);
        const double variance = (double)variance_of(&s, n);
        compare("variance", &variance, &P[n][n], 1);
    }
}

static void check_transition(void)
{
    fo_adaptive_state s;
    static fo_adaptive a;
    matrix P, F, Q = {{0}}, found;
    random_state(&s);
    memset(&a, 0, sizeof a);
    a.plain.h = (fo_real)0.01;
    const effects t = {{(fo_real)0.3, (fo_real)-0.2},
                       {(fo_real)0.05, (fo_real)0.07},
                       {(fo_real)0.06, (fo_real)0.08},
                       {(fo_real)-0.02, (fo_real)0.04},
                       ZERO};
    expand(&s, P);
    double p[FO_NP], moved[FO_NP];
    for (int i = 0; i < FO_NP; i++) {
        for (int j = 0; j < FO_NP; j++) {
            F[i][j] = i == j ? 1.0 : 0.0;
        }
    }
    for (int i = 0; i < FO_N; i++) {
        F[i][P_DRIFT + i] = 0.01;
        F[i][P_R] = -(double)t.before[i];
        F[i][P_V] = -(double)t.inverter[i];
    }
    for (int i = 0; i < FO_NP; i++) {
        /* the estimate goes by the interval itself, its derivative by the one before */
        p[i] = i < FO_N ? (double)t.v[i] + (double)(t.before[i] - t.charge[i]) * (double)s.p[P_R]
                        : 0.0;
        for (int j = 0; j < FO_NP; j++) {
            p[i] += F[i][j] * (double)s.p[j];
            for (int k = 0; k < FO_NP; k++) {
                for (int l = 0; l < FO_NP; l++) {
                    Q[i][j] += F[i][k] * P[k][l] * F[j][l];
                }
            }
        }
    }
    s.turn = 3U; /* no walk: its variance is zero */
    time_update(&a, &s, &t);
    expand(&s, found);
    for (int i = 0; i < FO_NP; i++) {
        moved[i] = (double)s.p[i];
    }
    compare("transition, covariance", &found[0][0], &Q[0][0], FO_NP * FO_NP);
    compare("transition, estimate", moved, p, FO_NP);
}

/* The cost of a candidate, straight from its definition. */
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
    static fo_adaptive_state s;
    fo_manifold m;
    fo_candidate c;
    memset(&a, 0, sizeof a);
    memset(&s, 0, sizeof s);
    memset(&c, 0, sizeof c);
    s.x[0] = ONE;
    s.p[P_PSI] = ONE;
    a.variance[P_PSI] = (fo_real)1e6; /* no prior to speak of */
    fo_information *info = &s.plain.info;
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
        fo_project(&a, &s, &c, &m);
    }
    double p[FO_NM];
    for (int i = 0; i < FO_NM; i++) {
        p[i] = (double)c.p[i];
    }
    const double here = cost_of(info, p, 2.0);
    for (int i = 0; i < FO_NM; i++) { /* the least: it rises to either side */
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

/* The covariance at the start is the inverse of the projection's information, and what is added for
 * resistance and inverter. */
static void check_start(void)
{
    static fo_adaptive a;
    static fo_adaptive_state s;
    fo_manifold m;
    fo_candidate c;
    matrix found;
    memset(&a, 0, sizeof a);
    memset(&s, 0, sizeof s);
    memset(&c, 0, sizeof c);
    memset(&m, 0, sizeof m);
    a.plain.h = (fo_real)0.01;
    a.plain.sample_time = (fo_real)1e-4;
    s.tracker.speed = (fo_real)300;
    s.D[P_PSI] = (fo_real)1e6; /* no prior of the magnet's flux */
    for (int i = 0; i < FO_NM * (FO_NM - 1) / 2; i++) {
        m.U[i] = (fo_real)uniform();
    }
    for (int i = 0; i < FO_NM; i++) {
        m.d[i] = (fo_real)(2.0 + uniform());
    }
    c.p[0] = ONE;
    c.p[4] = (fo_real)1.44;
    start(&a, &s, &c, &m, ONE);
    expand(&s, found);
    /* information in (flux, drift, psi): the square's by 2 psi */
    double product[FO_NM][FO_NM], one[FO_NM][FO_NM], info[FO_NM][FO_NM];
    for (int i = 0; i < FO_NM; i++) {
        for (int j = 0; j < FO_NM; j++) {
            info[i][j] = 0.0;
            for (int k = 0; k <= (i < j ? i : j); k++) {
                const double p = k == i ? 1.0 : (double)m.U[ROW(k, i)];
                const double q = k == j ? 1.0 : (double)m.U[ROW(k, j)];
                info[i][j] += p * q * (double)m.d[k];
            }
            info[i][j] *= (i == 4 ? 2.4 : 1.0) * (j == 4 ? 2.4 : 1.0);
        }
    }
    for (int i = 0; i < FO_NM; i++) {
        for (int j = 0; j < FO_NM; j++) {
            product[i][j] = 0.0;
            for (int k = 0; k < FO_NM; k++) {
                product[i][j] += info[i][k] * found[k][j];
            }
            one[i][j] = i == j ? 1.0 : 0.0;
        }
    }
    /* the prior of the magnet flux, a million, is not nothing */
    const double worst = 1e-4;
    for (int i = 0; i < FO_NM * FO_NM; i++) {
        if (!(fabs((&product[0][0])[i] - (&one[0][0])[i]) < worst)) {
            printf("start: not the inverse, %g\n", (&product[0][0])[i]);
            failed = 1;
        }
    }
}

/* From wherever it starts the tracker has to find angle and speed; there are speeds at which errors
 * of a few samples cancel, and a plain filter stays there. */
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

int main(void)
{
    for (int times = 0; times < 20; times++) {
        check_update();
        check_widen();
        check_transition();
        check_projection();
        check_start();
        for (int starts = 0; starts < 50; starts++) {
            check_tracker();
        }
    }
    return failed;
}
