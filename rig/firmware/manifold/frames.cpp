#include "frames.h"

namespace slider {

uint32_t crc32(const uint8_t* from, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; ++i) {
        crc ^= from[i];
        for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

size_t encode(const uint8_t* body, size_t size, uint8_t* frame) {
    if (size > LONGEST_BODY) return 0;
    const uint32_t check = crc32(body, size);
    // Below 254 bytes COBS needs no split block: each zero becomes the distance to the next zero.
    size_t code = 0, at = 1;
    for (size_t i = 0; i < size + 4; ++i) {
        const uint8_t byte = i < size ? body[i] : static_cast<uint8_t>(check >> 8 * (i - size));
        if (byte != 0) {
            frame[at++] = byte;
        } else {
            frame[code] = static_cast<uint8_t>(at - code);
            code = at++;
        }
    }
    frame[code] = static_cast<uint8_t>(at - code);
    frame[at++] = 0;
    return at;
}

// Decodes COBS in place. Returns false if a distance exceeds the end.
static bool decode_cobs(uint8_t* bytes, size_t size, size_t& decoded) {
    size_t to = 0;
    for (size_t at = 0; at < size;) {
        const size_t next = at + bytes[at];
        if (next > size) return false;
        for (++at; at < next; ++at) bytes[to++] = bytes[at];
        if (at < size) bytes[to++] = 0;
    }
    decoded = to;
    return true;
}

bool Decoder::take(uint8_t byte) {
    if (byte != 0) {
        if (filled_ == LONGEST_FRAME) noise_ = true;
        else frame_[filled_++] = byte;
        return false;
    }
    const size_t size = filled_;
    const bool noise = noise_;
    filled_ = 0;
    noise_ = false;
    if (size == 0) return false;
    size_t decoded = 0;
    if (!noise && decode_cobs(frame_, size, decoded) && decoded >= 4) {
        body_ = decoded - 4;
        const uint8_t* check = frame_ + body_;
        const uint32_t crc = crc32(frame_, body_);
        bool valid = true;
        for (int i = 0; i < 4; ++i) valid = valid && check[i] == ((crc >> 8 * i) & 0xFF);
        if (valid) return true;
    }
    ++damaged_;
    return false;
}

}  // namespace slider
