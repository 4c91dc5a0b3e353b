/* Vector table, C start-up and ARM semihosting for the processors that QEMU emulates. */
#include "target.h"

enum { SYS_WRITE0 = 0x04, SYS_EXIT_EXTENDED = 0x20, ADP_STOPPED_EXIT = 0x20026 };

extern uint32_t _stack_top, _data_load, _data, _edata, _bss, _ebss;

void Reset_Handler(void);
void *memcpy(void *to, const void *from, unsigned n);

static int32_t semihosting(int32_t operation, const void *argument)
{
    register int32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void target_write(const char *text) { (void)semihosting(SYS_WRITE0, text); }

void target_number(const char *name, int32_t value)
{
    char text[12];
    int i = 11;
    uint32_t left = value < 0 ? 0U - (uint32_t)value : (uint32_t)value;
    text[i] = '\0';
    do {
        i--;
        text[i] = (char)('0' + left % 10U);
        left /= 10U;
    } while (left > 0U);
    if (value < 0) {
        i--;
        text[i] = '-';
    }
    target_write(name);
    target_write(" ");
    target_write(&text[i]);
    target_write("\n");
}

static volatile uint32_t *const SYST = (volatile uint32_t *)0xE000E010U;

void target_start_ticks(void)
{
    SYST[1] = 0xFFFFFFU; /* reload */
    SYST[2] = 0U;
    SYST[0] = 5U; /* on, processor clock, no interrupt */
}

uint32_t target_ticks(void) { return SYST[2]; }

static void stop(int32_t code)
{
    const uint32_t reason[2] = {ADP_STOPPED_EXIT, (uint32_t)code};
    (void)semihosting(SYS_EXIT_EXTENDED, reason);
    for (;;) {
    }
}

static void fault(void)
{
    target_write("fault\n");
    stop(99);
}

typedef void (*handler)(void);
__attribute__((section(".vectors"), used)) static const handler vectors[16] = {
    (handler)(uintptr_t)&_stack_top, Reset_Handler, fault, fault, fault, fault, fault,
};

void Reset_Handler(void)
{
    const uint32_t *from = &_data_load;
    for (uint32_t *to = &_data; to < &_edata; to++) {
        *to = *from;
        from++;
    }
    for (uint32_t *to = &_bss; to < &_ebss; to++) {
        *to = 0U;
    }
#ifdef __ARM_FP
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* switch on the floating-point unit */
    __asm__ volatile("dsb\n isb");
#endif
    stop(main());
}
