/* The parts of Arduino's core that the exported sketches use, to run them on a computer. */
#pragma once
#include <cmath>
#include <cstdint>
#include <cstdio>

extern uint32_t now_us;
inline uint32_t micros() { return now_us; }
inline uint32_t millis() { return now_us / 1000; }
enum { A0 = 14, A2 = 16 };

struct SerialPort {
    void begin(long) {}
    explicit operator bool() const { return true; }
    void print(const char *text) { std::printf("%s", text); }
    void print(double value) { std::printf("%g", value); }
    void println(const char *text) { std::printf("%s\n", text); }
};
extern SerialPort Serial;

void setup();
void loop();
