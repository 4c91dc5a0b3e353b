/* A drive around the exported example interrupt. Standard input: rows of floats (i_a, i_b, i_c,
 * alpha and beta voltage commanded in this interrupt, whether the gates are on). Standard output:
 * one float per row, the angle that the control received, or 100 if the angle is unknown. */
#include <stdio.h>

#include "motor_observer.h"

static float row[6], angle;

void drive_read_currents(float i_abc[3]);
float drive_read_dc_link(void);
bool drive_gates_are_on(void);
void drive_write_voltage(const float command[2], float udc);
void drive_start(void);
void current_control_interrupt(void);

void drive_read_currents(float i_abc[3])
{
    for (int phase = 0; phase < 3; phase++) {
        i_abc[phase] = row[phase];
    }
}

float drive_read_dc_link(void) { return 48.0f; }

bool drive_gates_are_on(void) { return row[5] > 0.5f; }

void drive_write_voltage(const float command[2], float udc)
{
    (void)command;
    (void)udc;
}

static void take_command(float command[2])
{
    command[0] = row[3];
    command[1] = row[4];
}

void drive_current_control(const float i[2], float theta_e, float speed_e, bool position_known,
                           float udc, float command[2]);

void drive_current_control(const float i[2], float theta_e, float speed_e, bool position_known,
                           float udc, float command[2])
{
    (void)i;
    (void)speed_e;
    (void)udc;
    angle = position_known ? theta_e : 100.0f;
    take_command(command);
}

int main(void)
{
    drive_start();
    while (fread(row, sizeof row, 1, stdin) == 1) {
        current_control_interrupt();
        if (fwrite(&angle, sizeof angle, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
