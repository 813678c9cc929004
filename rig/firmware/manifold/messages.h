// Messages of protocol 1 (docs/reference/rig_protocol.md) between host and manifold. Host: rig/protocol/messages.py.
#pragma once

#include <cstddef>
#include <cstdint>

namespace slider {

constexpr uint16_t PROTOCOL = 1;
constexpr size_t CHAMBERS = 4;
constexpr size_t SAMPLE_BYTES = 4 * CHAMBERS;  // one pressure i32 for each chamber
constexpr size_t CHANNELS = CHAMBERS + 4;  // gauge pressures of chambers and supply [Pa]; three inputs [uV]
constexpr uint64_t WATCHDOG_US = 100000;

enum class State : uint8_t { BOOT, READY, ARMED, PLAYING, FAULT };
enum class Answer : uint8_t { DONE, UNKNOWN, WRONG_STATE, ABOVE_LIMIT, BELOW_ZERO, WRONG_PLACE };
enum class Cause : uint8_t { RESET, STOPPED, WATCHDOG, OVER_PRESSURE, REFUSED, PLAYED };

enum Type : uint8_t {
    HELLO = 0x01,
    SET_LIMITS = 0x02,
    ARM = 0x03,
    SET_PRESSURES = 0x04,
    HEARTBEAT = 0x05,
    STOP = 0x06,
    WAVE_BEGIN = 0x07,
    WAVE_PIECE = 0x08,
    WAVE_PLAY = 0x09,
    IDENT = 0x81,
    READING = 0x82,
    ACK = 0x83,
    EVENT = 0x84,
    FOLLOWS = 0x85,
};

// Returns whether a body (type byte and fields) has the type and size of a host's message.
bool from_host(const uint8_t* body, size_t size);

// Little-endian numbers, independent of the processor and of alignment.
inline uint16_t get_u16(const uint8_t* at) {
    return static_cast<uint16_t>(at[0] | at[1] << 8);
}
inline uint32_t get_u32(const uint8_t* at) {
    return get_u16(at) | static_cast<uint32_t>(get_u16(at + 2)) << 16;
}
inline int32_t get_i32(const uint8_t* at) {
    return static_cast<int32_t>(get_u32(at));
}

// A message under construction: `bytes[0 .. size)`. A Reading is the manifold's longest message.
struct Body {
    uint8_t bytes[16 + 4 * CHANNELS];
    size_t size = 0;

    explicit Body(Type type) { u8(type); }
    Body& u8(uint8_t value) { return number(value, 1); }
    Body& u16(uint16_t value) { return number(value, 2); }
    Body& u32(uint32_t value) { return number(value, 4); }
    Body& u64(uint64_t value) { return number(value, 8); }
    Body& i32(int32_t value) { return number(static_cast<uint32_t>(value), 4); }

private:
    Body& number(uint64_t value, size_t wide) {
        for (; wide > 0 && size < sizeof bytes; --wide, value >>= 8)
            bytes[size++] = static_cast<uint8_t>(value);
        return *this;
    }
};

}  // namespace slider
