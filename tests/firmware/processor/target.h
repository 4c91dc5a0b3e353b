/* Functions that the program needs on an emulated board: output, exit, and a count of
 * instructions. */
#ifndef TARGET_H
#define TARGET_H

#include <stdint.h>

void target_write(const char *text);
void target_number(const char *name, int32_t value);

/* Starts and reads the SysTick timer, which counts down. With QEMU's -icount an instruction lasts a
 * fixed virtual time, so that ticks give the exact number of instructions. */
void target_start_ticks(void);
uint32_t target_ticks(void);

int main(void);

#endif
