/* Simulates MESC, with two interrupts at the counter's top and one interrupt at its bottom. */
#include "motor.h"

#include "mesc_declarations.h"

void fluxobs_mesc_written(const MESC_motor_typedef *motor);
bool fluxobs_mesc_run(MESC_motor_typedef *motor);

static MESC_motor_typedef m;

/* Writes this voltage, turned by `turn`, as MESCpwm_Write does. */
static void write(const double u[2], double turn, double written[2])
{
    written[0] = cos(turn) * u[0] - sin(turn) * u[1];
    written[1] = sin(turn) * u[0] + cos(turn) * u[1];
    m.FOC.Vab.a = (float)written[0];
    m.FOC.Vab.b = (float)written[1];
    fluxobs_mesc_written(&m);
}

int main(int argc, char **argv)
{
    double u[2] = {0.0, 0.0}, top[2], bottom[2] = {0.0, 0.0}, i[2];
    motor_start(argc, argv, 5e-5);
    m.FOC.pwm_period = (float)motor.period;
    while (!motor_done()) {
        const bool on = motor_gates();
        const double half_turn = 0.5 * motor.period * motor.speed;
        m.MotorState = on ? MOTOR_STATE_RUN : MOTOR_STATE_IDLE;
        write(u, half_turn, top); /* the last command once more, turned: INTERPOLATE_V7_ANGLE */
        motor_current(i);
        m.FOC.Iab.a = (float)i[0];
        m.FOC.Iab.b = (float)i[1];
        const bool ours = on && fluxobs_mesc_run(&m);
        motor_judge(ours, TURN / 65536.0 * m.FOC.FOCAngle,
                    TURN / 65536.0 * m.FOC.PLL_int / motor.period, 0.0);
        motor_command(1.25, u);
        motor_half(bottom); /* the voltage written at the bottom acts from the top */
        write(u, 0.0, bottom);
        motor_half(top);
    }
    motor_report();
    return 0;
}
