// Buffer of frames to send. The buffer takes only whole frames, so a slow host never receives parts of frames.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace slider {

class Ring {
public:
    // 2.4 s of readings (54 bytes at 500 Hz), or 320 ms of a full line at 2 Mbaud.
    static constexpr size_t SIZE = 65536;

    // Takes a frame if `spare` bytes remain free. Otherwise counts the frame as lost.
    bool push(const uint8_t* frame, size_t size, size_t spare = 0) {
        if (size + spare > SIZE - filled_) {
            ++lost_;
            return false;
        }
        const size_t end = (begin_ + filled_) % SIZE;
        const size_t first = size < SIZE - end ? size : SIZE - end;
        memcpy(bytes_ + end, frame, first);
        memcpy(bytes_, frame + first, size - first);
        filled_ += size;
        return true;
    }
    // The oldest contiguous bytes, and their number.
    const uint8_t* front() const { return bytes_ + begin_; }
    size_t contiguous() const { return filled_ < SIZE - begin_ ? filled_ : SIZE - begin_; }
    void drop(size_t size) {
        begin_ = (begin_ + size) % SIZE;
        filled_ -= size;
    }
    size_t filled() const { return filled_; }
    uint32_t lost() const { return lost_; }

private:
    uint8_t bytes_[SIZE];
    size_t begin_ = 0;
    size_t filled_ = 0;
    uint32_t lost_ = 0;
};

}  // namespace slider
