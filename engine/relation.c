#include "relation.h"

#include <math.h>
#include <string.h>

enum { A = FO_ALPHA, B = FO_BETA, D = 0, Q = 1 };
/* Newton steps for the current of a flux; a linear machine takes one. */
enum { STEPS = 20 };
static const double close_enough = 1e-12; /* of the rated current */

/* Axes of the phases a, b, c; stator coordinates. */
static const double phase_axes[3][2] = {
    {1.0, 0.0}, {-0.5, 0.86602540378443864676}, {-0.5, -0.86602540378443864676}};

#define FO_LIST(order) order,
static const int orders[FO_ORDERS] = {FO_HARMONICS(FO_LIST)};
#undef FO_LIST

static double variance(double logarithm)
{
    return exp(2.0 * logarithm);
}

static fo_dual positive(const double *p, int index)
{
    return fo_exp_of(fo_unknown(p[index], index));
}

fo_model fo_model_of(const fo_machine *machine, const double p[FO_UNKNOWNS])
{
    fo_model m;
    m.machine = *machine;
    m.R = positive(p, FO_L_resistance);
    m.scale[D] = positive(p, FO_L_L_d);
    m.scale[Q] = positive(p, FO_L_L_q);
    m.psi = positive(p, FO_L_psi_f);
    m.mobility = fo_unknown(p[FO_L_mobility], FO_L_mobility);
    m.pole = p[FO_L_colour_pole];
    m.colour = p[FO_L_colour_gain];
    m.noise = variance(p[FO_L_noise]);
    m.acceleration = variance(p[FO_L_acceleration]);
    m.voltage = variance(p[FO_L_voltage]);
    m.drift = variance(p[FO_L_drift]);
    m.loss = exp(p[FO_L_loss]);
    m.inverse_knee = exp(-p[FO_L_knee]);
    m.lag = p[FO_L_lag] + p[FO_L_delay]; /* in the time of the currents */
    m.iron = p[FO_L_iron_loss];
    m.heat = p[FO_L_heat];
    m.rotation = p[FO_L_rotation];
    m.R_R = machine->cage ? exp(p[FO_L_rotor_resistance]) : 0.0;
    m.over_L_M = machine->cage ? exp(-p[FO_L_magnetizing]) : 0.0;
    m.saturation[D] = p[FO_L_saturation_d];
    m.saturation[Q] = p[FO_L_saturation_q];
    m.offset[A] = p[FO_L_offset_alpha];
    m.offset[B] = p[FO_L_offset_beta];
    m.unequal[A] = p[FO_L_gain_re];
    m.unequal[B] = p[FO_L_gain_im];
    m.range = p[FO_L_range];
    m.harmonics = p + FO_L;
    m.is_coloured = p[FO_L_colour_pole] != 0.0 || p[FO_L_colour_gain] != 0.0;
    return m;
}

/* What the derivative of the flux by the current depends on, but its scale. */
enum { BENDS = 4 };
/* Derivatives of a dual by the saturation of d; of q is the next. */
enum { OF_BEND = FO_SLOPES > 0 ? 1 + FO_L_saturation_d - FO_FIRST_OF_MODEL : 0 };

/* Flux of a current in rotor coordinates, without that of the magnets or the rotor. */
typedef struct {
    double flux[2];       /* [Wb] */
    double by[2][2];      /* its derivatives by the current [H] */
    double by_bend[2];    /* by the saturation of its own axis [Wb] */
    double bends[BENDS][2][2]; /* of `by`, by i_d, i_q and both saturations */
} mapped;

/* Least denominator of the saturation: beyond it, which no machine reaches, the flux is linear. */
static const double least_left = 0.2;
/* Share of the rated current at which the inductances are those of the parameters: there, the saturation
 * does not change them. Where i_d is constant, a log tells one number only; with the inductance at no
 * current, learning would crawl along a narrow valley. */
static const double reference = 0.5;

static mapped map_at(const fo_model *m, const double saturation[2], const double i[2])
{
    mapped f;
    double base[2], by[2][2];
    if (m->machine.map) {
        fo_mapped at;
        fo_map_at(m->machine.map, i, 0.0, &at);
        base[D] = at.flux[D] - m->machine.map->psi;
        base[Q] = at.flux[Q];
        by[D][D] = at.by_d[D];
        by[Q][D] = at.by_d[Q];
        by[D][Q] = at.by_q[D];
        by[Q][Q] = at.by_q[Q];
    } else {
        base[D] = i[D];
        base[Q] = i[Q];
        by[D][D] = by[Q][Q] = 1.0;
        by[D][Q] = by[Q][D] = 0.0;
    }
    for (int a = 0; a < 2; a++) {
        const double scale = m->scale[a].d[0], share = saturation[a] / m->machine.current;
        double left = 1.0, bend = 0.0;
        if (share != 0.0) {
            const double below = 1.0 + share * fabs(i[a]), own = 1.0 + reference * saturation[a];
            left = own / (below > least_left ? below : least_left);
            bend = below > least_left ? -share * left / below * (i[a] < 0.0 ? -1.0 : 1.0) : 0.0;
        }
        f.flux[a] = scale * left * base[a];
        for (int b = 0; b < 2; b++) f.by[a][b] = scale * left * by[a][b];
        f.by[a][a] += scale * bend * base[a];
        f.by_bend[a] = f.flux[a] * (reference / (1.0 + reference * saturation[a]) -
                                    fabs(i[a]) / (m->machine.current + saturation[a] * fabs(i[a])));
    }
    return f;
}

void fo_flux_of(const fo_model *m, double psi, const double current[2], double flux[2])
{
    const mapped f = map_at(m, m->saturation, current);
    flux[D] = psi + f.flux[D];
    flux[Q] = f.flux[Q];
}

/* Second derivatives: central differences of the first. */
static void bend(const fo_model *m, const double i[2], mapped *f)
{
    static const double share = 1e-5; /* of the rated current, and of 1 */
    for (int n = 0; n < BENDS; n++) {
        const double step = n < 2 ? share * m->machine.current : share;
        mapped ends[2];
        for (int k = 0; k < 2; k++) {
            double at[BENDS] = {i[D], i[Q], m->saturation[D], m->saturation[Q]};
            at[n] += k ? step : -step;
            ends[k] = map_at(m, at + 2, at);
        }
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++)
                f->bends[n][a][b] = (ends[1].by[a][b] - ends[0].by[a][b]) / (2.0 * step);
    }
}

/* Current of a flux: Newton's iteration. Steps are halved until the residual falls, since a map
 * bends. */
static mapped current_of(const fo_model *m, const double flux[2], const double begin[2], double i[2])
{
    memcpy(i, begin, 2 * sizeof *i);
    mapped f = map_at(m, m->saturation, i);
    double r[2] = {flux[D] - f.flux[D], flux[Q] - f.flux[Q]};
    for (int n = 0; n < STEPS; n++) {
        const double det = f.by[D][D] * f.by[Q][Q] - f.by[D][Q] * f.by[Q][D];
        const double step[2] = {(f.by[Q][Q] * r[D] - f.by[D][Q] * r[Q]) / det,
                                (f.by[D][D] * r[Q] - f.by[Q][D] * r[D]) / det};
        if (!(fabs(step[D]) + fabs(step[Q]) > close_enough * m->machine.current)) break;
        const double before = r[D] * r[D] + r[Q] * r[Q];
        double share = 1.0, tried[2];
        for (int half = 0; half < 8; half++, share *= 0.5) {
            for (int a = 0; a < 2; a++) tried[a] = i[a] + share * step[a];
            f = map_at(m, m->saturation, tried);
            for (int a = 0; a < 2; a++) r[a] = flux[a] - f.flux[a];
            if (r[D] * r[D] + r[Q] * r[Q] < before) break;
        }
        memcpy(i, tried, sizeof tried);
        if (!m->machine.map && m->saturation[D] == 0.0 && m->saturation[Q] == 0.0) break;
    }
    if (FO_SLOPES > 0 && m->machine.saturates) bend(m, i, &f);
    return f;
}

/* r ← x turned by the angle of (c, s). */
static fo_pair turned(fo_pair x, double c, double s)
{
    const fo_pair r = {fo_axpy(fo_scale(c, x.a), -s, x.b), fo_axpy(fo_scale(s, x.a), c, x.b)};
    return r;
}

/* ∂i/∂λ in rotor coordinates; `i`: the current. */
static void invert(const fo_model *m, const mapped *f, const fo_dual i[2], fo_dual inverse[2][2])
{
    fo_dual by[2][2];
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            const double relative = f->by[a][b] / m->scale[a].d[0];
            by[a][b] = fo_scale(relative, m->scale[a]);
            if (FO_SLOPES == 0 || !m->machine.saturates) continue;
            for (int k = 1; k < FO_WIDTH; k++)
                by[a][b].d[k] += f->bends[D][a][b] * i[D].d[k] + f->bends[Q][a][b] * i[Q].d[k];
            for (int k = 0; k < 2; k++) by[a][b].d[OF_BEND + k] += f->bends[2 + k][a][b];
        }
    const bool coupled = f->by[D][Q] != 0.0 || f->by[Q][D] != 0.0;
    if (!coupled && !m->machine.map) {
        inverse[D][D] = fo_inverse(by[D][D]);
        inverse[Q][Q] = fo_inverse(by[Q][Q]);
        inverse[D][Q] = inverse[Q][D] = fo_constant(0.0);
        return;
    }
    const fo_dual over =
        fo_inverse(fo_msub(fo_mul(by[D][D], by[Q][Q]), by[D][Q], by[Q][D]));
    inverse[D][D] = fo_mul(by[Q][Q], over);
    inverse[Q][Q] = fo_mul(by[D][D], over);
    inverse[D][Q] = fo_scale(-1.0, fo_mul(by[D][Q], over));
    inverse[Q][D] = fo_scale(-1.0, fo_mul(by[Q][D], over));
}

/* Harmonics of the flux and what they change, in rotor coordinates. */
typedef struct {
    double value[2], slope[2];                 /* by the angle */
    double unit[FO_ORDERS][2];                 /* e^{jhθ} */
} harmonics_at;

static void harmonics_of(const fo_model *m, double c, double s, harmonics_at *out)
{
    double powers[7][2] = {{1.0, 0.0}};
    memset(out, 0, sizeof *out);
    for (int n = 1; n <= 6; n++) {
        powers[n][A] = powers[n - 1][A] * c - powers[n - 1][B] * s;
        powers[n][B] = powers[n - 1][A] * s + powers[n - 1][B] * c;
    }
    for (int n = 0; n < FO_ORDERS; n++) {
        const int order = orders[n], size = order < 0 ? -order : order;
        const double u = powers[size][A], v = order < 0 ? -powers[size][B] : powers[size][B];
        const double a = m->harmonics[2 * n], b = m->harmonics[2 * n + 1];
        const double x = a * u - b * v, y = a * v + b * u;
        out->unit[n][A] = u;
        out->unit[n][B] = v;
        out->value[A] += x;
        out->value[B] += y;
        out->slope[A] -= order * y;
        out->slope[B] += order * x;
    }
}

void fo_flux_at(const fo_model *m, double angle, double psi, const double current[2], double flux[2])
{
    const double c = cos(angle), s = sin(angle);
    const double rotor[2] = {c * current[A] + s * current[B], c * current[B] - s * current[A]};
    double own[2];
    harmonics_at h;
    harmonics_of(m, c, s, &h);
    fo_flux_of(m, psi + m->psi.d[0], rotor, own);
    own[D] += h.value[D];
    own[Q] += h.value[Q];
    flux[A] = c * own[D] - s * own[Q];
    flux[B] = s * own[D] + c * own[Q];
}

/* Derivatives of the current and of ∂i/∂θ by the harmonics: −e^{jθ} Λ e^{jhθ} (a + j b), and
 * −e^{jθ} (j Λ + Λ j h) e^{jhθ} (a + j b). */
static void by_harmonics(const harmonics_at *h, fo_dual inverse[2][2], double c, double s,
                         fo_prediction *p)
{
    const double L[2][2] = {{inverse[D][D].d[0], inverse[D][Q].d[0]},
                            {inverse[Q][D].d[0], inverse[Q][Q].d[0]}};
    for (int n = 0; n < FO_ORDERS; n++)
        for (int part = 0; part < 2; part++) {
            const double u = part ? -h->unit[n][B] : h->unit[n][A],
                         v = part ? h->unit[n][A] : h->unit[n][B];
            const double x = L[D][D] * u + L[D][Q] * v, y = L[Q][D] * u + L[Q][Q] * v;
            const int at = 2 * n + part, column = FO_L - FO_FIRST_OF_MEANS + at;
            p->by[A][column] = -(c * x - s * y);
            p->by[B][column] = -(s * x + c * y);
            const double t = orders[n];
            const double x_t = y - t * (L[D][D] * -v + L[D][Q] * u),
                         y_t = -x - t * (L[Q][D] * -v + L[Q][Q] * u);
            p->angle_by[A][at] = c * x_t - s * y_t;
            p->angle_by[B][at] = s * x_t + c * y_t;
        }
}

/* The sensor of a phase saturates at its range: the excess is missing along the axis of the phase. */
static void clip(const fo_model *m, fo_prediction *p)
{
    fo_dual *i[2] = {&p->measured.a, &p->measured.b};
    const double x = i[A]->d[0], y = i[B]->d[0];
    p->clipped = false;
    p->sensed[A][A] = p->sensed[B][B] = 1.0;
    p->sensed[A][B] = p->sensed[B][A] = 0.0;
    if (!(m->range > 0.0) || x * x + y * y < m->range * m->range) return;
    const fo_pair whole = p->measured;
    for (int n = 0; n < 3; n++) {
        const double *d = phase_axes[n], phase = d[A] * x + d[B] * y;
        const double most = phase < 0.0 ? -m->range : m->range;
        if (fabs(phase) <= m->range) continue;
        p->clipped = true;
        const fo_dual lacking = fo_shift(-most, fo_axpy(fo_scale(d[A], whole.a), d[B], whole.b));
        for (int a = 0; a < 2; a++) {
            *i[a] = fo_axpy(*i[a], -2.0 / 3.0 * d[a], lacking);
            p->sensed[a][A] -= 2.0 / 3.0 * d[a] * d[A];
            p->sensed[a][B] -= 2.0 / 3.0 * d[a] * d[B];
        }
        for (int a = 0; FO_SLOPES > 0 && a < 2; a++)
            p->measured_by[a][FO_L_range - FO_FIRST_OF_MEANS] += 2.0 / 3.0 * d[a] * (phase < 0.0 ? -1.0 : 1.0);
    }
    if (!p->clipped) return;
    for (int k = 0; FO_SLOPES > 0 && k < FO_COLUMNS; k++) {
        if (k == FO_L_range - FO_FIRST_OF_MEANS) continue;
        const double u = p->measured_by[A][k], v = p->measured_by[B][k];
        for (int a = 0; a < 2; a++) p->measured_by[a][k] = p->sensed[a][A] * u + p->sensed[a][B] * v;
    }
}

/* By the parameters of the means. */
static void measured_by_means(const fo_model *m, fo_prediction *p)
{
    const fo_pair t = p->terminal;
    const double g = m->unequal[A], k = m->unequal[B];
    for (int n = 0; n < FO_COLUMNS; n++) {
        p->measured_by[A][n] = (1.0 + g) * p->by[A][n] + k * p->by[B][n];
        p->measured_by[B][n] = (1.0 - g) * p->by[B][n] + k * p->by[A][n];
    }
    p->measured_by[A][FO_L_offset_alpha - FO_FIRST_OF_MEANS] = 1.0;
    p->measured_by[B][FO_L_offset_beta - FO_FIRST_OF_MEANS] = 1.0;
    p->measured_by[A][FO_L_gain_re - FO_FIRST_OF_MEANS] = t.a.d[0];
    p->measured_by[B][FO_L_gain_re - FO_FIRST_OF_MEANS] = -t.b.d[0];
    p->measured_by[A][FO_L_gain_im - FO_FIRST_OF_MEANS] = t.b.d[0];
    p->measured_by[B][FO_L_gain_im - FO_FIRST_OF_MEANS] = t.a.d[0];
}

/* What the sensors add: i_t + o + g conj(i_t). */
static void measure_current(const fo_model *m, fo_prediction *p)
{
    const fo_pair t = p->terminal;
    const double g = m->unequal[A], k = m->unequal[B];
    p->measured = (fo_pair){fo_shift(m->offset[A], fo_axpy(fo_scale(1.0 + g, t.a), k, t.b)),
                            fo_shift(m->offset[B], fo_axpy(fo_scale(1.0 - g, t.b), k, t.a))};
    if (FO_SLOPES > 0) measured_by_means(m, p);
    clip(m, p);
}

/* e^{−jθ} λ = ψ + Σ a e^{jhθ} + m(i) with i in rotor coordinates; Λ = ∂i/∂λ. If the rotor turns by δ,
 * e^{−jθ} λ turns by −δ: ∂i/∂θ = e^{jθ} [j i − Λ (j λ + Σ j h a e^{jhθ})] in rotor coordinates. */
void fo_predict(const fo_model *m, const fo_course *at, double speed, const double begin[2],
                fo_prediction *p)
{
    const double c = cos(at->angle), s = sin(at->angle);
    const double flux[2] = {c * at->flux[A] + s * at->flux[B], c * at->flux[B] - s * at->flux[A]};
    harmonics_at h;
    if (FO_SLOPES > 0) memset(p->by, 0, sizeof p->by);
    harmonics_of(m, c, s, &h);
    const double psi = at->psi + m->psi.d[0];
    const double own[2] = {flux[D] - h.value[D] - psi, flux[Q] - h.value[Q]};
    const mapped f = current_of(m, own, begin, p->rotor);
    /* ∂i = −Λ (∂ψ + ∂m): of ψ, of the scales of m and of its saturation. */
    fo_dual shift[2] = {m->psi, fo_constant(0.0)}, i[2], inverse[2][2];
    for (int a = 0; a < 2; a++) {
        for (int k = 1; k < FO_WIDTH; k++)
            shift[a].d[k] += f.flux[a] / m->scale[a].d[0] * m->scale[a].d[k];
        if (FO_SLOPES > 0) shift[a].d[OF_BEND + a] += f.by_bend[a];
    }
    const double det = f.by[D][D] * f.by[Q][Q] - f.by[D][Q] * f.by[Q][D];
    const double over[2][2] = {{f.by[Q][Q] / det, -f.by[D][Q] / det},
                               {-f.by[Q][D] / det, f.by[D][D] / det}};
    for (int a = 0; a < 2; a++) {
        i[a] = fo_constant(p->rotor[a]);
        for (int b = 0; b < 2; b++)
            for (int k = 1; k < FO_WIDTH; k++) i[a].d[k] -= over[a][b] * shift[b].d[k];
    }
    invert(m, &f, i, inverse);
    if (FO_SLOPES > 0) by_harmonics(&h, inverse, c, s, p);
    const fo_pair in_rotor = {i[D], i[Q]};
    p->current = turned(in_rotor, c, s);
    /* Iron: j ω λ is the induced voltage. */
    const double induced[2] = {-speed * at->flux[B], speed * at->flux[A]};
    for (int a = 0; FO_SLOPES > 0 && a < 2; a++) p->by[a][FO_L_iron_loss - FO_FIRST_OF_MEANS] = induced[a];
    p->terminal = (fo_pair){fo_shift(m->iron * induced[A], p->current.a),
                            fo_shift(m->iron * induced[B], p->current.b)};
    measure_current(m, p);
    const double moved[2] = {flux[Q] - h.slope[D], -flux[D] - h.slope[Q]};
    fo_pair by_angle, by_psi;
    by_angle.a = fo_sub(fo_axpy(fo_scale(moved[D], inverse[D][D]), moved[Q], inverse[D][Q]), i[Q]);
    by_angle.b = fo_add(fo_axpy(fo_scale(moved[Q], inverse[Q][Q]), moved[D], inverse[Q][D]), i[D]);
    by_psi.a = fo_scale(-1.0, inverse[D][D]);
    by_psi.b = fo_scale(-1.0, inverse[Q][D]);
    by_angle = turned(by_angle, c, s);
    by_psi = turned(by_psi, c, s);
    p->slope[A][FO_BY_ANGLE] = by_angle.a;
    p->slope[B][FO_BY_ANGLE] = by_angle.b;
    p->slope[A][FO_BY_PSI] = by_psi.a;
    p->slope[B][FO_BY_PSI] = by_psi.b;
    /* e^{jθ} Λ e^{−jθ} */
    const fo_dual sum = fo_add(inverse[D][Q], inverse[Q][D]);
    p->slope[A][FO_BY_ALPHA] =
        fo_axpy(fo_axpy(fo_scale(c * c, inverse[D][D]), s * s, inverse[Q][Q]), -c * s, sum);
    p->slope[B][FO_BY_BETA] =
        fo_axpy(fo_axpy(fo_scale(s * s, inverse[D][D]), c * c, inverse[Q][Q]), c * s, sum);
    const fo_dual both = fo_axpy(fo_scale(c * s, inverse[D][D]), -c * s, inverse[Q][Q]);
    p->slope[A][FO_BY_BETA] = fo_axpy(fo_axpy(both, c * c, inverse[D][Q]), -s * s, inverse[Q][D]);
    p->slope[B][FO_BY_ALPHA] = fo_axpy(fo_axpy(both, c * c, inverse[Q][D]), -s * s, inverse[D][Q]);
}

fo_signs fo_signs_of(const fo_model *m, const double middle[2], const double step[2], size_t periods)
{
    const double share = 2.0 / 3.0 / (double)periods;
    fo_signs s;
    memset(&s, 0, sizeof s);
    for (int n = 0; n < 3; n++) {
        const double *d = phase_axes[n];
        const double at = m->inverse_knee * (d[A] * middle[A] + d[B] * middle[B]);
        const double along = m->inverse_knee * (d[A] * step[A] + d[B] * step[B]);
        double value = 0.0, slope = 0.0, by_knee = 0.0;
        for (size_t k = 0; k < periods; k++) {
            const double x = at + along * (((double)k + 0.5) / (double)periods - 0.5), t = tanh(x);
            value += t;
            slope += 1.0 - t * t;
            by_knee -= (1.0 - t * t) * x;
        }
        for (int a = 0; a < 2; a++) {
            s.value[a] += share * d[a] * value;
            s.by_knee[a] += share * d[a] * by_knee;
            for (int b = 0; b < 2; b++)
                s.by_current[a][b] += share * d[a] * d[b] * slope * m->inverse_knee;
        }
    }
    return s;
}
