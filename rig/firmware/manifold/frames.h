// Messages on the wire: a body, its CRC-32, stuffed by COBS, and a zero byte; rig/protocol/frames.py is its twin.
#pragma once

#include <cstddef>
#include <cstdint>

namespace slider {

constexpr size_t LONGEST_FRAME = 192;  // bytes between two zeros; more are noise
constexpr size_t LONGEST_BODY = 160;   // that `encode` takes; no message has more than 133

// That of zlib and Ethernet.
uint32_t crc32(const uint8_t* from, size_t size);

// Writes the frame of a body, its zero included, to `frame` (LONGEST_FRAME bytes); returns its size,
// 0 for a body of more than LONGEST_BODY bytes.
size_t encode(const uint8_t* body, size_t size, uint8_t* frame);

// Bodies of a stream of bytes; what is damaged is counted.
class Decoder {
public:
    // Takes one byte; true if a sound body ended with it, in `body()` until the next byte.
    bool take(uint8_t byte);
    const uint8_t* body() const { return frame_; }
    size_t size() const { return body_; }
    uint32_t damaged() const { return damaged_; }

private:
    uint8_t frame_[LONGEST_FRAME];
    size_t filled_ = 0;
    size_t body_ = 0;
    bool noise_ = false;
    uint32_t damaged_ = 0;
};

}  // namespace slider
