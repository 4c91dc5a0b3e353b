/* The part of MESC that mesc_fluxobs.c uses: names, types and fields, as facts. Source:
 * github.com/davidmolony/MESC_Firmware, commit aa159cc6, MESC_Common/Inc/: MESCfoc.h,
 * MESCmotor_state.h. The real structures have more fields, in another order.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MESC_DECLARATIONS_H
#define MESC_DECLARATIONS_H

#include <stdint.h>

typedef enum { MOTOR_STATE_TRACKING = 6, MOTOR_STATE_RUN = 7, MOTOR_STATE_IDLE = 13 } motor_state_e;

typedef struct {
    float a, b, g;
} MESCiab_s;

typedef struct {
    uint16_t FOCAngle; /* 65536: a turn */
    MESCiab_s Vab;     /* written last [V] */
    MESCiab_s Iab;     /* [A] */
    float pwm_period;  /* [s] */
    float PLL_int;     /* 65536ths of a turn in a PWM period */
} MESCfoc_s;

typedef struct {
    uint16_t inject; /* HFI is on */
} MESChfi_s;

typedef struct {
    motor_state_e MotorState;
    MESChfi_s HFI;
    MESCfoc_s FOC;
} MESC_motor_typedef;

#endif
