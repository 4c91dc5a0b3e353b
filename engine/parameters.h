/* Unknowns of the likelihood of a log: levels of its errors, and parameters of the machine. */
#ifndef FLUXOBS_PARAMETERS_H
#define FLUXOBS_PARAMETERS_H

/* Levels change covariances only. */
#define FO_OF_LEVELS(NAME)                                                                       \
    NAME(noise)        /* ln of the std of a component of the current's noise             [A]  */ \
    NAME(acceleration) /* ln of the std by which the acceleration changes         [rad/s²/√s] */ \
    NAME(voltage)      /* ln of the std of the voltage's error, white                [V √s]    */ \
    NAME(drift)        /* ln of the std by which the drift changes in a second       [V/√s]    */

/* Colour of the current's noise, n = z + w, z⁺ = ρ z + g w. */
#define FO_OF_COLOUR(NAME)                                                                       \
    NAME(colour_pole)  /* ρ                                                               [1]  */ \
    NAME(colour_gain)  /* g; 0: white                                                     [1]  */

/* The linearised model depends on these, so means and covariances do. */
#define FO_OF_MODEL(NAME)                                                                        \
    NAME(resistance)   /* ln R                                                            [Ω]  */ \
    NAME(L_d)          /* ln L_d; of a flux map: ln of its scale                  [H] or [1]  */ \
    NAME(L_q)          /* ln L_q                                                               */ \
    NAME(psi_f)        /* ln ψ                                                            [Wb] */ \
    NAME(saturation_d) /* s: the flux is L i (1 + s/2)/(1 + s |i|/rated)                  [1] */ \
    NAME(saturation_q)                                                                         \
    NAME(mobility)     /* acceleration of the angle over flux × current, 3/2 n_p²/J [1/(kg m²)] */

/* These change the means only. */
#define FO_OF_MEANS(NAME)                                                                        \
    NAME(loss)         /* ln of the voltage loss of a phase                               [V]  */ \
    NAME(knee)         /* ln of the current at which the loss is 76 % of its value        [A]  */ \
    NAME(lag)          /* the voltages act later than the log says                   [samples] */ \
    NAME(delay)        /* the currents are older than the log says                   [samples] */ \
    NAME(rotation)     /* share of the turn of the voltage that it makes within a row         [1] */ \
    NAME(iron_loss)    /* current per induced voltage                                   [A/V] */ \
    NAME(heat)         /* relative change of R from the first to the last row             [1] */ \
    NAME(rotor_resistance) /* cage: ln R_R                                               [Ω] */ \
    NAME(magnetizing)  /* cage: ln L_M                                                   [H] */ \
    NAME(offset_alpha) /* of the measured current                                         [A] */ \
    NAME(offset_beta)                                                                            \
    NAME(gain_re)      /* unequal gains of the current sensors, g in i + g conj(i)        [1] */ \
    NAME(gain_im)                                                                              \
    NAME(range)        /* of the sensor of a phase: larger currents read as this          [A] */

/* Harmonics of the flux in rotor coordinates, Σ a e^{jhθ} [Wb]: their orders h. Unequal phases have
 * order −2, a magnet's fifth and seventh harmonic −6 and 6. Order −1 is a constant in stator
 * coordinates, which the flux itself takes. */
#define FO_HARMONICS(ORDER) ORDER(-2) ORDER(2) ORDER(-4) ORDER(4) ORDER(-6) ORDER(6)

#define FO_PARAMETER_INDEX(name) FO_L_##name,
enum {
    FO_OF_LEVELS(FO_PARAMETER_INDEX) FO_OF_COLOUR(FO_PARAMETER_INDEX)
    FO_OF_MODEL(FO_PARAMETER_INDEX) FO_OF_MEANS(FO_PARAMETER_INDEX) FO_L
};
#undef FO_PARAMETER_INDEX

#define FO_COUNT(order) +1
/* After the parameters: two coefficients of each harmonic [Wb]. */
enum { FO_ORDERS = 0 FO_HARMONICS(FO_COUNT), FO_UNKNOWNS = FO_L + 2 * FO_ORDERS };
/* How many there are of a kind, and the first of each. FO_VARIANCES: levels and colour, which make the
 * covariance of the currents. */
enum {
    FO_LEVELS = 0 FO_OF_LEVELS(FO_COUNT),
    FO_VARIANCES = FO_LEVELS FO_OF_COLOUR(FO_COUNT),
    FO_T = 0 FO_OF_MODEL(FO_COUNT)
};
enum { FO_FIRST_OF_MODEL = FO_L_resistance, FO_FIRST_OF_MEANS = FO_L_loss };
#undef FO_COUNT

#endif
