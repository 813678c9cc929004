// The part of a Teensy that the sketch uses.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

constexpr int OUTPUT = 1;

struct Board {
    uint64_t now = 0;
    int counts[64] = {};
    int duties[64] = {};
    bool output[64] = {};
    int bits = 10;
};
inline Board board;

inline uint32_t micros() { return static_cast<uint32_t>(board.now); }
inline void pinMode(uint8_t pin, int mode) { board.output[pin] = mode == OUTPUT; }
inline void analogWrite(uint8_t pin, int duty) { board.duties[pin] = duty; }
inline int analogRead(uint8_t pin) { return board.counts[pin] >> (12 - board.bits); }
inline void analogReadResolution(unsigned bits) { board.bits = static_cast<int>(bits); }
inline void analogReadAveraging(unsigned) {}

struct Link {
    std::deque<uint8_t> in;
    std::vector<uint8_t> out;
    int room = 0;
    bool begun = false;
    void begin(uint32_t) { begun = true; }
    int available() const { return static_cast<int>(in.size()); }
    int read() {
        const int byte = in.front();
        in.pop_front();
        return byte;
    }
    int availableForWrite() const { return room; }
    size_t write(const uint8_t* from, size_t size) {
        out.insert(out.end(), from, from + size);
        room -= static_cast<int>(size);
        return size;
    }
};
inline Link Serial;
