/* The part of the VESC firmware that vesc_fluxobs.c uses: names, types and fields, as facts.
 * Source: github.com/vedderb/bldc, commit b9d287b3 (7.01): motor/foc_math.h (motor_state_t,
 * motor_all_state_t), datatypes.h (mc_state, mc_foc_control_sample_mode, mc_configuration). The
 * real structures have more fields, in another order.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef VESC_DECLARATIONS_H
#define VESC_DECLARATIONS_H

typedef enum { MC_STATE_OFF = 0, MC_STATE_DETECTING, MC_STATE_RUNNING, MC_STATE_FULL_BRAKE } mc_state;

typedef enum {
    FOC_CONTROL_SAMPLE_MODE_V0 = 0,
    FOC_CONTROL_SAMPLE_MODE_V0_V7,
    FOC_CONTROL_SAMPLE_MODE_V0_V7_INTERPOL
} mc_foc_control_sample_mode;

typedef struct {
    mc_foc_control_sample_mode foc_control_sample_mode;
} mc_configuration;

typedef struct {
    float mod_alpha_measured, mod_beta_measured; /* 1: 2/3 of the bus; without dead time */
    float i_alpha, i_beta;                       /* [A] */
    float v_bus;                                 /* [V], low pass */
} motor_state_t;

typedef struct {
    mc_configuration *m_conf;
    mc_state m_state;
    motor_state_t m_motor_state;
    float m_phase_now_observer; /* [rad] */
    float m_pll_phase;          /* [rad] */
    float m_pll_speed;          /* electrical [rad/s] */
} motor_all_state_t;

#endif
