/* Simulates the VESC firmware: mcpwm_foc_adc_int_handler calls the shim. */
#include "motor.h"

#include "vesc_declarations.h"

bool fluxobs_vesc_run(motor_all_state_t *motor);

#ifdef HW_HAS_PHASE_SHUNTS
static const mc_foc_control_sample_mode MODE = FOC_CONTROL_SAMPLE_MODE_V0_V7;
#else
static const mc_foc_control_sample_mode MODE = FOC_CONTROL_SAMPLE_MODE_V0;
#endif

int main(int argc, char **argv)
{
    mc_configuration conf = {MODE};
    motor_all_state_t m = {.m_conf = &conf, .m_motor_state = {.v_bus = (float)BUS}};
    double u[2] = {0.0, 0.0}, old[2] = {0.0, 0.0}, i[2];
    motor_start(argc, argv, 1e-4);
    while (!motor_done()) {
        const bool on = motor_gates();
        motor_current(i);
        m.m_state = on ? MC_STATE_RUNNING : MC_STATE_OFF;
        m.m_motor_state.i_alpha = on ? (float)i[0] : 0.0f;
        m.m_motor_state.i_beta = on ? (float)i[1] : 0.0f;
        const bool ours = fluxobs_vesc_run(&m);
        motor_judge(ours, m.m_phase_now_observer, m.m_pll_speed, 0.0);
        motor_command(MODE == FOC_CONTROL_SAMPLE_MODE_V0 ? 1.0 : 1.5, u);
        m.m_motor_state.mod_alpha_measured = on ? (float)(1.5 * u[0] / BUS) : 0.0f;
        m.m_motor_state.mod_beta_measured = on ? (float)(1.5 * u[1] / BUS) : 0.0f;
        motor_half(old);
        motor_half(MODE == FOC_CONTROL_SAMPLE_MODE_V0 ? u : old);
        memcpy(old, u, sizeof u);
    }
    motor_report();
    return 0;
}
