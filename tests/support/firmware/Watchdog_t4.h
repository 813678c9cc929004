// The part of the watchdog that the sketch uses: its time, and a count of its feeds.
#pragma once

struct WDT_timings_t {
    double timeout = 10;
};
constexpr int WDT3 = 3;
inline double watchdog_ms = 0;
inline unsigned watchdog_fed = 0;

template <int>
struct WDT_T4 {
    void begin(WDT_timings_t timings) { watchdog_ms = timings.timeout; }
    void feed() { ++watchdog_fed; }
};
