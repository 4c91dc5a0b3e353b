/* The relation of flux, current and angle that a sample of a log must satisfy, with every
 * assumption of assumptions.h. Theory: docs/theory.md, section 16. */
#ifndef FLUXOBS_MODEL_H
#define FLUXOBS_MODEL_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "assumptions.h"
#include "fluxobs_map.h"
#include "vector.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers of the model and of the estimation. */
#define FO_MODEL_FIELDS(NUMBER)                                                                \
    NUMBER(sample_time)     /* [s]                                                          */ \
    NUMBER(resistance)      /* [Ω]                                                          */ \
    NUMBER(inverter_voltage) /* loss of a phase that the voltages already lack [V]          */ \
    NUMBER(psi)             /* magnet flux [Wb]; 0 without magnets                          */ \
    NUMBER(flux_base)       /* usual flux that turns with the rotor [Wb]                    */ \
    NUMBER(R_R)             /* cage machine: rotor resistance [Ω], else 0                   */ \
    NUMBER(L_M)             /* cage machine: magnetizing inductance [H], else 0             */ \
    NUMBER(current)         /* rated current [A]                                            */ \
    NUMBER(voltage)         /* usual voltage [V]                                            */ \
    NUMBER(current_noise)   /* std of a component [A]                                       */ \
    NUMBER(feedback_d)      /* the voltage loses this multiple of the noise of i_d [V/A]      */ \
    NUMBER(feedback_q)      /* the same of i_q                                               */ \
    NUMBER(feedback_rows)   /* rows until the voltage's interval ends; 0: no feedback         */ \
    NUMBER(speed)           /* usual electrical speed [rad/s]                               */ \
    NUMBER(drift_std)       /* of a component [V]                                           */ \
    NUMBER(one_inductance)  /* 1: L_d stands for L_q too                                    */ \
    NUMBER(model_error)     /* residual of the relation, share of the flux                  */ \
    NUMBER(cell_error)      /* the same, constant at an operating point and angle           */ \
    NUMBER(voltage_error)   /* unmodelled share of the inverter's loss                      */ \
    NUMBER(psi_rate)        /* change of the magnet flux [1/√s]                             */ \
    NUMBER(resistance_rate) /* change of the resistance [1/√s]                              */ \
    NUMBER(rotor_flux_start) /* cage: share of the steady rotor flux at the first row       */ \
    NUMBER(injection)       /* 1: an injected current shows the direction of the flux       */

#define FO_MODEL_NUMBER(name) double name;
typedef struct {
    FO_MODEL_FIELDS(FO_MODEL_NUMBER)
    double std[FO_P]; /* prior of each assumption; 0: exact */
    fo_map map;
} fo_model;
#undef FO_MODEL_NUMBER

/* The relation at one sample and angle. */
typedef struct {
    vec flux;         /* in rotor coordinates, with harmonics [Wb] */
    vec by_d, by_q;   /* its derivatives by the current [H] */
    vec map;          /* flux of the current, before its scales [Wb] */
    vec along;        /* unit vector along the auxiliary flux */
    vec sixth;        /* e^{6jφ} */
    double size;      /* length of the auxiliary flux [Wb] */
} fo_relation;

/* Least denominator below: `saturation` may be negative. */
#define FO_LEAST_DENOMINATOR 0.4

/* Share of the inductance that a current leaves: 1 / (1 + saturation |i| / rated current). */
static inline double fo_unsaturated(const fo_model *m, double saturation, double current)
{
    if (saturation == 0.0) return 1.0;
    const double below = 1.0 + saturation * fabs(current) / m->current;
    return 1.0 / (below > FO_LEAST_DENOMINATOR ? below : FO_LEAST_DENOMINATOR);
}

/* `psi` [Wb] is the flux of the magnets or of the rotor. */
void fo_relate(const fo_model *m, const double p[FO_P], double psi, vec current, vec rotor,
               fo_relation *at);

/* Moves `angle` until the flux and the relation agree across the auxiliary flux; returns the
 * residual along it [Wb]. `current` and `flux` in stator coordinates. */
double fo_solve_angle(const fo_model *m, const double p[FO_P], double psi, vec current, vec flux,
                      double *angle, vec *rotor, vec *in_rotor, fo_relation *at);

/* Smoothed sign of the phase currents as a vector; with its derivative, a symmetric matrix. */
typedef struct {
    vec sign;
    double dd, dq, qq;
} fo_sign;
void fo_phase_signs(vec current, double knee, fo_sign *out);

/* Inverter's loss of a phase [V], >= 0. */
double fo_inverter_loss(const fo_model *m, const double p[FO_P]);

/* Current without offset and unequal gains. */
static inline vec fo_corrected(const double p[FO_P], vec i)
{
    const vec offset = vec_of(p[FO_P_offset_alpha], p[FO_P_offset_beta]),
              gain = vec_of(p[FO_P_current_gain_re], p[FO_P_current_gain_im]);
    return minus(minus(i, offset), product(gain, conjugate(i)));
}

/* Part of the loss that its parameters do not describe [V]. */
double fo_inverter_error(const fo_model *m, const double p[FO_P]);

/* Voltage error that every inverter has, as a share of the voltage. */
#define FO_VOLTAGE_SHARE 0.003
/* Share of its prior by which the drift changes in a second. */
#define FO_DRIFT_RATE 0.05

/* Length below which the relation does not tell an angle, as a share of the flux. */
#define FO_SHORTEST_SHARE 0.02

#ifdef __cplusplus
}
#endif
#endif
