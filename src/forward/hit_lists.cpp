// SPDX-License-Identifier: Apache-2.0
// Bindings of forward/append, forward/sort_hits and forward/blend, and how much room lists have.
#include "forward/hit_lists.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include <relidar/error.hpp>

namespace relidar {
namespace {

constexpr int kMostRoom = RELIDAR_MOST_ROOM;
constexpr std::size_t kMostBytes = std::size_t(1) << 30;    // of all lists
constexpr std::size_t kMostLists = std::size_t(1) << 24;    // threads that sort them are counted in 32 bits
constexpr std::size_t kTogether = 32;                       // lists that lie side by side

std::size_t bytes_of(std::size_t n_lists, int room) { return n_lists * static_cast<std::size_t>(room) * sizeof(shared::Hit); }

}  // namespace

HitLists::HitLists(Device& device, const KernelVariant& variant, const std::vector<Constant>& constants, int room)
    : device_(device),
      append_(device, "forward/append", variant, constants),
      blend_(device, "forward/blend", constants),
      room_(room),
      n_overflows_(device, std::vector<std::uint32_t>{0u}, "rays with more hits than their lists have room for"),
      overflows_(device, sizeof(std::uint32_t), "rays with more hits than their lists have room for") {
    make_sort();
}

void HitLists::make_sort() {
    sort_.emplace(device_, KernelName<shared::SortHitsParams>("forward/sort_hits"),
                  std::vector<Constant>{{ConstantId::ROOM, static_cast<std::uint32_t>(room_)}});
}

/// As many lists, with as much of the room as there is memory for; without any, none.
void HitLists::make_lists(std::size_t n_lists, int room) {
    const std::size_t n = (n_lists + kTogether - 1) / kTogether * kTogether;
    const int before = room_;
    hits_ = {};
    for (room_ = n > kMostLists ? 0 : room; room_ > 0; room_ /= 2) {
        if (bytes_of(n, room_) > kMostBytes) continue;
        try {
            hits_ = Array<shared::Hit>(device_, n * static_cast<std::size_t>(room_), "lists of hits");
            lengths_ = Array<std::uint32_t, shared::ListLengths>(device_, n, "lengths of lists of hits");
            break;
        } catch (const DeviceError&) {   // no memory for so many
        }
    }
    n_lists_ = n;
    if (room_ < room) grows_ = false;
    if (room_ > 0 && room_ != before) make_sort();
}

/// Whether more than one ray in a hundred had more hits than its list has room for. Looked at so late that it costs no wait: the stream
/// has waited for that submission, to record into its slot again.
bool HitLists::wants_more_room(Stream& stream) {
    if (!overflows_.pending() || impl_of(stream).last_ticket + 1 < counted_until_ + Stream::Impl::kSlots) return false;
    std::uint32_t count = 0;
    std::memcpy(&count, overflows_.wait(stream), sizeof count);
    const std::uint32_t n_overflows = count - std::exchange(overflows_before_, count);
    return grows_ && room_ < kMostRoom && 100 * static_cast<std::size_t>(n_overflows) > counted_rays_;
}

void HitLists::make_room(Stream& stream, std::size_t n_lists) {
    const bool more = wants_more_room(stream);
    if (!more && n_lists <= n_lists_) return;
    if (n_lists_ > 0) stream.finish();   // nobody may be writing lists that go
    make_lists(std::max(n_lists, n_lists_), more ? std::min(2 * room_, kMostRoom) : room_);
    stream.fill(n_overflows_);   // those of shorter lists
    overflows_before_ = 0;
    rays_since_ = 0;
}

void HitLists::count_overflows(Stream& stream, std::size_t n_rays) {
    rays_since_ += n_rays;
    if (!grows_ || room_ >= kMostRoom || overflows_.pending()) return;
    overflows_.record(stream, n_overflows_.buffer(), sizeof(std::uint32_t));
    counted_until_ = impl_of(stream).last_ticket + 1;
    counted_rays_ = std::exchange(rays_since_, 0);
}

void HitLists::run(Stream& stream, const RayBatch& batch, shared::ForwardParams& params) {
    const std::size_t n = trace_threads(batch);
    make_room(stream, n);
    if (room_ == 0) return;
    params.lists = {.hits = hits_.address(),
                    .lengths = lengths_.address(),
                    .n = static_cast<std::uint32_t>(n),
                    .room = static_cast<std::uint32_t>(room_)};
    relidar::run(stream, append_, n, {.scene = params.scene, .lists = params.lists, .n_overflows = n_overflows_.address()});
    count_overflows(stream, batch.n_rays);
    relidar::run(stream, *sort_, n * sort_->impl().workgroup_size, {.lists = params.lists});
    relidar::run(stream, blend_, n, params);
}

}  // namespace relidar
