/* What the estimate of a log assumes: each may be a little wrong. p holds the deviations from the
 * values of the machine and from ideal sensors; their posterior is the budget of a row's error. */
#ifndef FLUXOBS_ASSUMPTIONS_H
#define FLUXOBS_ASSUMPTIONS_H

#define FO_ASSUMPTIONS(NAME)                                                                   \
    NAME(resistance)       /* [Ω]                                                           */ \
    NAME(inverter_hard)    /* voltage loss of a phase with a hard sign of its current [V]   */ \
    NAME(inverter_soft)    /* with a soft sign [V]                                          */ \
    NAME(inverter_curve)   /* bend of the loss over the current [1]                         */ \
    NAME(lag)              /* the voltages act later than the log says [samples]            */ \
    NAME(delay)            /* the currents are sampled later than the log says [samples]    */ \
    NAME(offset_alpha)     /* of the measured current [A]                                   */ \
    NAME(offset_beta)                                                                          \
    NAME(current_gain_re)  /* unequal gains of the current sensors, g in i + g conj(i) [1]  */ \
    NAME(current_gain_im)                                                                      \
    NAME(duty_gain)        /* gain of a sensor over the voltage of its phase [1]            */ \
    NAME(voltage_gain_re)  /* unequal gains of the phase voltages, likewise [1]             */ \
    NAME(voltage_gain_im)                                                                      \
    NAME(link_sag)         /* share of the voltages lost at the rated current [1]           */ \
    NAME(iron_loss)        /* current per induced voltage [A/V]                             */ \
    NAME(L_d)              /* share of the inductance, or of the flux of the current [1]    */ \
    NAME(L_q)                                                                                  \
    NAME(saturation_d)     /* s: the current leaves 1 / (1 + s |i|/rated) of its flux [1]   */ \
    NAME(saturation_q)                                                                         \
    NAME(psi_f)            /* [Wb]                                                          */ \
    NAME(fifth)            /* harmonics of the magnet flux, shares of the flux [1]          */ \
    NAME(seventh)                                                                              \
    NAME(R_R)              /* rotor resistance, share [1]                                   */ \
    NAME(L_M)              /* magnetizing inductance, share [1]                             */ \
    NAME(tilt)             /* of the axis that an injected current shows [rad]              */

#define FO_ASSUMPTION_INDEX(name) FO_P_##name,
enum { FO_ASSUMPTIONS(FO_ASSUMPTION_INDEX) FO_P };
#undef FO_ASSUMPTION_INDEX

#endif
