#include "messages.h"

namespace slider {

bool from_host(const uint8_t* body, size_t size) {
    if (size == 0) return false;
    switch (body[0]) {
        case HELLO:
        case ARM:
        case HEARTBEAT:
        case STOP:
            return size == 3;
        case SET_LIMITS:
        case SET_PRESSURES:
            return size == 3 + SAMPLE_BYTES;
        case WAVE_BEGIN:
            return size == 9;
        case WAVE_PIECE:
            return size >= 5 + SAMPLE_BYTES && size <= 5 + 8 * SAMPLE_BYTES && (size - 5) % SAMPLE_BYTES == 0;
        case WAVE_PLAY:
            return size == 7;
        default:
            return false;
    }
}

}  // namespace slider
