// Frames of the serial line: a body and CRC-32, encoded by COBS, then a zero byte. Host: rig/protocol/messages.py.
#pragma once

#include <cstddef>
#include <cstdint>

namespace slider {

constexpr size_t LONGEST_FRAME = 192;  // bytes between two zeros; a longer run is noise
constexpr size_t LONGEST_BODY = LONGEST_FRAME - 6;  // largest body of `encode`: COBS byte, CRC and zero are added

// Returns the CRC-32 as defined by zlib and Ethernet.
uint32_t crc32(const uint8_t* from, size_t size);

// Writes the frame of a body, with its final zero, to `frame` (LONGEST_FRAME bytes). Returns the frame's size,
// or 0 for a body longer than LONGEST_BODY.
size_t encode(const uint8_t* body, size_t size, uint8_t* frame);

// Decodes the bodies in a byte stream, and counts damaged frames.
class Decoder {
public:
    // Takes one byte. Returns true if this byte completes a valid body, which stays in `body()` until the next byte.
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
