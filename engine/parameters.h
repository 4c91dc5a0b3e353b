/* Unknowns of the likelihood of a log: parameters of the machine, and levels of its errors. */
#ifndef FLUXOBS_PARAMETERS_H
#define FLUXOBS_PARAMETERS_H

#define FO_PARAMETERS(NAME)                                                                    \
    NAME(resistance)   /* ln R                                                          [Ω]  */ \
    NAME(L_d)          /* ln L_d                                                        [H]  */ \
    NAME(L_q)          /* ln L_q                                                        [H]  */ \
    NAME(psi_f)        /* ln ψ                                                          [Wb] */ \
    NAME(loss)         /* voltage loss of a phase                                       [V]  */ \
    NAME(knee)         /* ln of the current at which the loss is 76 % of its value      [A]  */ \
    NAME(mobility)     /* acceleration of the angle over flux × current, 3/2 n_p²/J [1/(kg m²)] */ \
    NAME(lag)          /* the voltages act later than the log says                 [samples] */ \
    NAME(noise)        /* ln of the std of a component of the current's noise           [A]  */ \
    NAME(acceleration) /* ln of the std by which the acceleration changes  [rad/s²/√s] */ \
    NAME(voltage)      /* ln of the std of the voltage's error, white              [V √s]    */ \
    NAME(drift)        /* ln of the std by which the drift changes in a second     [V/√s]    */ \
    NAME(gain)         /* ln of the std by which the voltage's gain changes        [1/√s]    */ \
    NAME(colour_pole)  /* ρ of the current's noise, n = z + w, z⁺ = ρ z + g w           [1]  */ \
    NAME(colour_gain)  /* g; 0: white                                                   [1]  */

/* Harmonics of the flux in rotor coordinates, Σ a e^{jhθ} [Wb]: their orders h. An offset of the
 * current has order −1, unequal phases −2, slots and the curve of the inverter's loss ±6. */
#define FO_HARMONICS(ORDER) ORDER(-1) ORDER(-2) ORDER(2) ORDER(-4) ORDER(4) ORDER(-6) ORDER(6)

#define FO_PARAMETER_INDEX(name) FO_L_##name,
enum { FO_PARAMETERS(FO_PARAMETER_INDEX) FO_L };
#undef FO_PARAMETER_INDEX

#define FO_COUNT(order) +1
/* The last unknown: the angle of the first row, with its current held [rad]. */
enum { FO_ORDERS = 0 FO_HARMONICS(FO_COUNT), FO_TURN = FO_L + 2 * FO_ORDERS, FO_UNKNOWNS };
#undef FO_COUNT

#endif
