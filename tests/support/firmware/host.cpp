// Runs the firmware's core and its parts with stdin and stdout: one output record per input record.
//   in:  kind u8, device time u64 [us], size u16, payload     out: size u16, bytes, state u8, set pressures 4 i32
//                                                                  (-1 while venting), damaged u32, lost u32
// Kinds: I new core with the Settings of Ident, F bytes from the host, T a pass with 8 channels, B the same without
// reading the ring, D bytes for a decoder (returns each body after its size u8), E a body to encode, L pairs of set
// and measured pressure (returns duties). All numbers are little endian.
#include <cstdio>
#include <memory>
#include <vector>

#include "manifold_core.h"
#include "valves.h"

using namespace slider;

struct Rig {
    Settings settings;
    Ring out;
    std::vector<Sample> wave;
    ManifoldCore core;
    explicit Rig(const Settings& s) : settings(s), wave(s.longest), core(settings, wave.data(), out) {}
};

static Settings settings_of(const uint8_t* p) {
    Settings s = {get_u16(p), {p[2], p[3], p[4]}, get_u16(p + 5), get_u16(p + 7), {}};
    for (size_t i = 0; i < CHAMBERS; ++i) s.hard_limits[i] = get_i32(p + 9 + 4 * i);
    return s;
}

template <class T>
static void put(T value) {
    fwrite(&value, sizeof value, 1, stdout);
}

int main() {
    std::unique_ptr<Rig> rig;
    Decoder decoder;
    uint8_t head[11];
    while (fread(head, sizeof head, 1, stdin) == 1) {
        const uint64_t now = get_u32(head + 1) | static_cast<uint64_t>(get_u32(head + 5)) << 32;
        // The heap buffer has the exact size, so a sanitizer detects a read beyond it.
        std::vector<uint8_t> payload(get_u16(head + 9)), sent;
        if (!payload.empty() && fread(payload.data(), payload.size(), 1, stdin) != 1) return 1;
        const uint8_t* p = payload.data();
        uint32_t damaged = decoder.damaged();
        if (head[0] == 'I') {
            rig = std::make_unique<Rig>(settings_of(p));
        } else if (head[0] == 'F') {
            rig->core.feed(p, payload.size(), now);
        } else if (head[0] == 'T' || head[0] == 'B') {
            int32_t channels[CHANNELS];
            for (size_t i = 0; i < CHANNELS; ++i) channels[i] = get_i32(p + 4 * i);
            rig->core.tick(now, channels);
        } else if (head[0] == 'D') {
            for (uint8_t byte : payload) {
                if (!decoder.take(byte)) continue;
                sent.push_back(static_cast<uint8_t>(decoder.size()));
                sent.insert(sent.end(), decoder.body(), decoder.body() + decoder.size());
            }
            damaged = decoder.damaged();
        } else if (head[0] == 'E') {
            sent.resize(LONGEST_FRAME);
            sent.resize(encode(p, payload.size(), sent.data()));
        } else if (head[0] == 'L') {
            for (size_t i = 0; i + 8 <= payload.size(); i += 8) {
                const Duty duty = law(get_i32(p + i), get_i32(p + i + 4));
                sent.insert(sent.end(), {duty.fill, duty.vent});
            }
        }
        if (rig && (head[0] == 'F' || head[0] == 'T')) {
            while (rig->out.filled() > 0) {
                const size_t run = rig->out.contiguous();
                sent.insert(sent.end(), rig->out.front(), rig->out.front() + run);
                rig->out.drop(run);
            }
        }
        if (rig && head[0] != 'D') damaged = rig->core.damaged();
        put(static_cast<uint16_t>(sent.size()));
        if (!sent.empty()) fwrite(sent.data(), 1, sent.size(), stdout);
        put(rig ? static_cast<uint8_t>(rig->core.state()) : uint8_t{0});
        const int32_t* set = rig ? rig->core.set_pressures() : nullptr;
        for (size_t i = 0; i < CHAMBERS; ++i) put(set ? set[i] : int32_t{-1});
        put(damaged);
        put(rig ? rig->out.lost() : 0u);
    }
    return 0;
}
