/* The part of ST's motor control SDK (X-CUBE-MCSDK 5.4.4) that mcsdk_fluxobs.c uses: names, types
 * and fields, as facts. MCLib/Any/Inc/: mc_type.h, speed_pos_fdbk.h, bus_voltage_sensor.h.
 * Generated: drive_parameters.h, parameters_conversion.h, power_stage_parameters.h, mc_stm_types.h.
 * The numbers are an example; the Workbench generates yours. The real structures have more fields.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MCSDK_DECLARATIONS_H
#define MCSDK_DECLARATIONS_H

#include <stdint.h>

#define ADC_REFERENCE_VOLTAGE 3.30
#define RSHUNT 0.00500
#define AMPLIFICATION_GAIN 24.00
#define VBUS_PARTITIONING_FACTOR 0.0300
#define PWM_FREQUENCY 10000
#define REGULATION_EXECUTION_RATE 1 /* PWM periods from one control to the next */
#define SPEED_UNIT 10               /* unit of a mechanical speed: 1 Hz / this */

typedef struct {
    int16_t alpha, beta;
} alphabeta_t;

typedef struct {
    alphabeta_t Ialphabeta; /* [s16A] */
    alphabeta_t Valphabeta; /* [s16V] */
} FOCVars_t;

typedef struct {
    uint8_t bElToMecRatio;            /* pole pairs */
    int16_t hElAngle;                 /* 65536: a turn */
    int16_t hAvrMecSpeedUnit;         /* [SPEED_UNIT] */
    int16_t hElSpeedDpp;              /* 65536ths of a turn in a control period */
    int16_t InstantaneousElSpeedDpp;  /* the same */
} SpeednPosFdbk_Handle_t;

#endif
