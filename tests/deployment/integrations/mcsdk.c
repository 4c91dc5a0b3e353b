/* Simulates a project of ST's SDK: TSK_HighFrequencyTask calls the shim, with 16-bit numbers. */
#include "motor.h"

#include "mcsdk_declarations.h"
#include "motor_observer.h"

extern SpeednPosFdbk_Handle_t fluxobs_speed;
void fluxobs_mcsdk_start(void);
bool fluxobs_mcsdk_run(const FOCVars_t *foc, uint16_t bus);

int main(int argc, char **argv)
{
    const double amperes = ADC_REFERENCE_VOLTAGE / (2.0 * RSHUNT * AMPLIFICATION_GAIN);
    const double bus = BUS / (ADC_REFERENCE_VOLTAGE / VBUS_PARTITIONING_FACTOR);
    const double volts = BUS / sqrt(3.0);
    double u[2] = {0.0, 0.0}, old[2] = {0.0, 0.0}, abc[3];
    bool was_on = false, odd = false;
    FOCVars_t foc = {0};
    motor_start(argc, argv, 1.0 / PWM_FREQUENCY);
    while (!motor_done()) {
        const bool on = motor_gates();
        bool reliable = false;
        if (on != was_on) {
            fluxobs_mcsdk_start(); /* FOC_Clear, at start and stop */
        }
        was_on = on;
        motor_currents(abc);
        motor_command(1.0, u);
        if (on) {
            /* MCM_Clarke, and the command that FOC_CurrControllerM1 has just made */
            foc.Ialphabeta.alpha = (int16_t)lrint(32768.0 * abc[0] / amperes);
            foc.Ialphabeta.beta =
                (int16_t)lrint(-32768.0 * (abc[0] + 2.0 * abc[1]) / sqrt(3.0) / amperes);
            foc.Valphabeta.alpha = (int16_t)lrint(32768.0 * u[0] / volts);
            foc.Valphabeta.beta = (int16_t)lrint(-32768.0 * u[1] / volts);
            reliable = fluxobs_mcsdk_run(&foc, (uint16_t)lrint(65536.0 * bus));
        }
        odd = !odd; /* the same speed in two units */
        motor_judge(reliable, TURN / 65536.0 * (fluxobs_speed.hElAngle - 16384),
                    odd ? TURN / 65536.0 * fluxobs_speed.hElSpeedDpp / motor.period
                        : TURN * motor_pole_pairs * fluxobs_speed.hAvrMecSpeedUnit / SPEED_UNIT,
                    motor.period);
        motor_half(old);
        motor_half(u);
        memcpy(old, u, sizeof u);
    }
    motor_report();
    return 0;
}
