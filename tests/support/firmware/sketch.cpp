// Runs the sketch on a simulated board: one input and one output record per pass of its loop.
//   in:  device time u64 [us], counts of the pins 14 to 21 8 u16, room to write u16, size u16, bytes from the host
//   out: size u16, bytes to the host, duties of the pins 2 to 9 8 u8, number of watchdog feeds u32
// The first output record is from `setup`: the bytes are the watchdog's time [ms] u16, and for each of the pins 2 to
// 9 whether it is an output.
#include <cstdio>

#include "Arduino.h"
#include "manifold.ino"

template <class T>
static void put(T value) {
    fwrite(&value, sizeof value, 1, stdout);
}

static void write_record(const std::vector<uint8_t>& sent) {
    put(static_cast<uint16_t>(sent.size()));
    if (!sent.empty()) fwrite(sent.data(), 1, sent.size(), stdout);
    for (int pin = 2; pin < 10; ++pin) put(static_cast<uint8_t>(board.duties[pin]));
    put(static_cast<uint32_t>(watchdog_fed));
}

int main() {
    setup();
    const uint16_t ms = static_cast<uint16_t>(watchdog_ms);
    std::vector<uint8_t> pins = {static_cast<uint8_t>(ms & 0xFF), static_cast<uint8_t>(ms >> 8)};
    for (int pin = 2; pin < 10; ++pin) pins.push_back(board.output[pin]);
    write_record(pins);
    struct __attribute__((packed)) {
        uint64_t now;
        uint16_t counts[8], room, size;
    } pass;
    while (fread(&pass, sizeof pass, 1, stdin) == 1) {
        board.now = pass.now;
        for (int i = 0; i < 8; ++i) board.counts[14 + i] = pass.counts[i];
        Serial.room = pass.room;
        std::vector<uint8_t> bytes(pass.size);
        if (!bytes.empty() && fread(bytes.data(), bytes.size(), 1, stdin) != 1) return 1;
        Serial.in.insert(Serial.in.end(), bytes.begin(), bytes.end());
        loop();
        write_record(Serial.out);
        Serial.out.clear();
    }
    return 0;
}
