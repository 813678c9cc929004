// Valve law of the published firmware (bvanstratum/SoftSnakePressureControl). The duty is min(250, 10 |error|) of 255,
// with the error in counts of a ten-bit converter. A positive error drives the fill valve, otherwise the vent valve.
#pragma once

#include <cstdint>

namespace slider {

constexpr float PA_PER_PUBLISHED_COUNT = 932.8f;  // 0.13529 psi
constexpr float GAIN = 10.0f / PA_PER_PUBLISHED_COUNT;  // duty of 255 per pascal
constexpr float MAX_DUTY = 250.0f;

// Duties of a chamber's two valves, from 0 to 255.
struct Duty {
    uint8_t fill;
    uint8_t vent;
};

constexpr Duty VENTING = {0, 255};

inline Duty law(int32_t set_Pa, int32_t read_Pa) {
    const float error = static_cast<float>(set_Pa) - static_cast<float>(read_Pa);
    const float wanted = GAIN * (error > 0 ? error : -error);
    const uint8_t duty = static_cast<uint8_t>(wanted < MAX_DUTY ? wanted : MAX_DUTY);
    return error > 0 ? Duty{duty, 0} : Duty{0, duty};
}

}  // namespace slider
