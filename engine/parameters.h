/* Unknowns of the likelihood of a log: parameters of the machine, and levels of its errors. */
#ifndef FLUXOBS_PARAMETERS_H
#define FLUXOBS_PARAMETERS_H

#define FO_PARAMETERS(NAME)                                                                    \
    NAME(resistance)   /* ln R                                                          [Ω]  */ \
    NAME(L_d)          /* ln L_d                                                        [H]  */ \
    NAME(L_q)          /* ln L_q                                                        [H]  */ \
    NAME(psi_f)        /* ln ψ                                                          [Wb] */ \
    NAME(loss)         /* voltage loss of a phase                                       [V]  */ \
    NAME(lag)          /* the voltages act later than the log says                 [samples] */ \
    NAME(noise)        /* ln of the std of a component of the current's noise           [A]  */ \
    NAME(acceleration) /* ln of the std by which the speed changes in a second  [rad/s/√s]   */ \
    NAME(voltage)      /* ln of the std of the voltage's error, white              [V √s]    */ \
    NAME(drift)        /* ln of the std by which the drift changes in a second     [V/√s]    */ \
    NAME(colour_pole)  /* ρ of the current's noise, n = z + w, z⁺ = ρ z + g w           [1]  */ \
    NAME(colour_gain)  /* g; 0: white                                                   [1]  */

#define FO_PARAMETER_INDEX(name) FO_L_##name,
enum { FO_PARAMETERS(FO_PARAMETER_INDEX) FO_L };
#undef FO_PARAMETER_INDEX

#endif
