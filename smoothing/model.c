#include "model.h"

/* Steps of the iteration for the angle: each squares its error, and the first guess is close. */
enum { STEPS = 4 };
/* An angle step below this [rad] ends the iteration; it is applied, but not evaluated again: its
 * square is the error of the angle, and half of it that of the residual. */
#define CLOSE 5e-4
/* Largest step [rad]: beyond it the linear prediction is worthless. */
#define LARGEST_STEP 0.5

/* Loss of the share per current [1/A]. */
static double bend(const fo_model *m, double saturation, double current, double left)
{
    if (saturation == 0.0) return 0.0;
    const double slope = saturation / m->current * left * left;
    return current < 0.0 ? -slope : slope;
}

void fo_relate(const fo_model *m, const double p[FO_P], double psi, vec current, vec rotor,
               fo_relation *at)
{
    fo_mapped f;
    const double i[2] = {current.re, current.im};
    fo_map_at(&m->map, i, 0.0, &f);
    const double d = 1.0 + p[FO_P_L_d], q = 1.0 + p[m->one_inductance > 0.0 ? FO_P_L_d : FO_P_L_q];
    const double left_d = fo_unsaturated(m, p[FO_P_saturation_d], i[0]),
                 left_q = fo_unsaturated(m, p[FO_P_saturation_q], i[1]);
    /* Derivatives of the scales by the current. */
    const double bent_d = bend(m, p[FO_P_saturation_d], i[0], left_d) * d,
                 bent_q = bend(m, p[FO_P_saturation_q], i[1], left_q) * q;
    at->map = vec_of(f.flux[0] - m->map.psi, f.flux[1]);
    const double scale_d = d * left_d, scale_q = q * left_q;
    at->by_d = vec_of(f.by_d[0] * scale_d - bent_d * at->map.re, f.by_d[1] * scale_q);
    at->by_q = vec_of(f.by_q[0] * scale_d, f.by_q[1] * scale_q - bent_q * at->map.im);
    at->flux = vec_of(psi + at->map.re * scale_d, at->map.im * scale_q);
    const vec second = product(rotor, rotor);
    at->sixth = product(second, product(second, second));
    const vec fifth = times(m->flux_base * p[FO_P_fifth], conjugate(at->sixth)),
              seventh = times(m->flux_base * p[FO_P_seventh], at->sixth);
    const vec inner = minus(times(i[0], at->by_q), times(i[1], at->by_d));
    vec a = plus(at->flux, turned(inner));
    a = plus(a, minus(times(7.0, seventh), times(5.0, fifth)));
    at->flux = plus(at->flux, plus(fifth, seventh));
    const double size = length_of(a), least = FO_SHORTEST_SHARE * m->flux_base;
    at->size = size > least ? size : least;
    at->along = size > 0.0 ? times(1.0 / size, a) : vec_of(1.0, 0.0);
}

double fo_solve_angle(const fo_model *m, const double p[FO_P], double psi, vec current, vec flux,
                      double *angle, vec *rotor, vec *in_rotor, fo_relation *at)
{
    for (int n = 0;; n++) {
        double unit[2];
        fo_direction(wrapped(*angle), unit);
        *rotor = vec_of(unit[0], unit[1]);
        *in_rotor = product(current, conjugate(*rotor));
        fo_relate(m, p, psi, *in_rotor, *rotor, at);
        const vec rest = minus(product(flux, conjugate(*rotor)), at->flux);
        const double step = dot(rest, turned(at->along)) / at->size;
        *angle += clamp(step, -LARGEST_STEP, LARGEST_STEP);
        if (n + 1 == STEPS || fabs(step) < CLOSE) return dot(rest, at->along);
    }
}

double fo_inverter_loss(const fo_model *m, const double p[FO_P])
{
    const double loss = m->inverter_voltage + p[FO_P_inverter_hard] + p[FO_P_inverter_soft];
    return loss > 0.0 ? loss : 0.0;
}

/* Least inverter loss, as a share of its prior. */
#define LEAST_LOSS 0.1

double fo_inverter_error(const fo_model *m, const double p[FO_P])
{
    /* Behind the hard knee and behind the soft one: with opposite signs, the loss at large currents
     * may vanish, and a voltage error of zero would make wrong parameters certain. */
    const double small = fabs(m->inverter_voltage + p[FO_P_inverter_hard]),
                 large = fo_inverter_loss(m, p), least = LEAST_LOSS * m->std[FO_P_inverter_hard];
    return m->voltage_error * fmax(fmax(small, large), least);
}

/* tanh differs from 1 by 3e-8 here. */
#define SATURATED 9.0

void fo_phase_signs(vec current, double knee, fo_sign *out)
{
    static const vec axis[3] = {
        {1.0, 0.0}, {-0.5, 0.8660254037844386}, {-0.5, -0.8660254037844386}};
    out->sign = vec_of(0.0, 0.0);
    out->dd = out->dq = out->qq = 0.0;
    for (int n = 0; n < 3; n++) {
        const double x = dot(current, axis[n]) / knee;
        if (fabs(x) >= SATURATED) {
            out->sign = plus(out->sign, times(x > 0.0 ? 2.0 / 3.0 : -2.0 / 3.0, axis[n]));
        } else {
            const double sign = tanh(x), slope = (1.0 - sign * sign) / knee * (2.0 / 3.0);
            out->sign = plus(out->sign, times(sign * (2.0 / 3.0), axis[n]));
            out->dd += slope * axis[n].re * axis[n].re;
            out->dq += slope * axis[n].re * axis[n].im;
            out->qq += slope * axis[n].im * axis[n].im;
        }
    }
}
