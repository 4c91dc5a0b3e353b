/* The relation of flux, angle and current of a machine, and the inverter's loss. */
#ifndef FLUXOBS_RELATION_H
#define FLUXOBS_RELATION_H

#include <stdbool.h>

#include "dual.h"
#include "fluxobs_map.h"
#include "values.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FO_TURN 6.283185307179586 /* a whole one [rad] */

enum { FO_ALPHA, FO_BETA }; /* components of a vector */

/* Derivatives by the parameters that change the means only. */
enum { FO_COLUMNS = FO_UNKNOWNS - FO_FIRST_OF_MEANS };

/* What the current depends on: flux α and β, angle, ψ. */
enum { FO_BY_ALPHA, FO_BY_BETA, FO_BY_ANGLE, FO_BY_PSI, FO_BY };

/* Kind of a machine, and its constants that are not estimated. */
typedef struct {
    const fo_map *map; /* flux over the current, scaled by L_d and L_q [1]; null: L_d and L_q [H] */
    bool cage;         /* d is along the rotor flux, which follows i_d */
    bool saturates;    /* its inductances depend on the current, or may do so */
    double current;    /* rated [A] */
    double psi_rate;   /* std by which the flux of magnets or rotor changes [Wb/√s] */
} fo_machine;

/* Parameters; duals of those of the model. */
typedef struct {
    fo_machine machine;
    fo_dual R, scale[2], psi, mobility;
    double pole, colour;
    double noise, acceleration, voltage, drift; /* variances */
    double loss, inverse_knee, lag, rotation, iron, heat, offset[2], unequal[2], range;
    double R_R, over_L_M;      /* of a cage [Ω], [1/H] */
    double saturation[2];
    const double *harmonics;   /* two coefficients of each order */
    bool is_coloured;
} fo_model;

fo_model fo_model_of(const fo_machine *machine, const double parameters[FO_UNKNOWNS]);

/* Where the model is linearised at a row. */
typedef struct {
    double flux[2]; /* stator coordinates [Wb] */
    double angle;   /* without jumps of a turn [rad] */
    double psi;     /* flux of magnets or rotor, less the parameter [Wb] */
    double unrest;  /* factor on the variance by which the acceleration changes until the next row */
    double doubt;   /* factor on the variance of the noise of the current */
} fo_course;

/* The current at a row of the course, and its derivatives; stator coordinates. */
typedef struct {
    double rotor[2];  /* in rotor coordinates [A] */
    fo_pair current;  /* that makes flux */
    fo_pair terminal; /* with that of the iron loss */
    fo_pair measured; /* by the sensors */
    double sensed[2][2]; /* derivative of the measured current by the terminal's, if it is clipped */
    bool clipped;
    fo_dual slope[2][FO_BY];   /* derivatives of the current */
    double by[2][FO_COLUMNS]; /* by the parameters of the means */
    double measured_by[2][FO_COLUMNS];
    double angle_by[2][2 * FO_ORDERS]; /* of that by the angle, by the harmonics */
} fo_prediction;

/* `rotor` of the prediction of the row before is where the search for the current begins. */
void fo_predict(const fo_model *m, const fo_course *at, double speed, const double begin[2],
                fo_prediction *out);

/* Flux of a current without harmonics; both in rotor coordinates. */
void fo_flux_of(const fo_model *m, double psi, const double current[2], double flux[2]);

/* Flux of a current at an angle and ψ, less the parameter; stator coordinates. */
void fo_flux_at(const fo_model *m, double angle, double psi, const double current[2], double flux[2]);

/* Sum of the phases' smoothed signs as a vector, amplitude-invariant, with its derivatives by the
 * current and by ln knee. */
typedef struct {
    double value[2], by_current[2][2], by_knee[2];
} fo_signs;

/* Mean over the middles of `periods` equal parts of a line: its middle, and the step along it [A]. */
fo_signs fo_signs_of(const fo_model *m, const double middle[2], const double step[2], size_t periods);

#ifdef __cplusplus
}
#endif
#endif
