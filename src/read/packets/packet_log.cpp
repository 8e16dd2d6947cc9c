// SPDX-License-Identifier: Apache-2.0
#include "read/packets/packet_log.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <span>
#include <utility>

#include <fmt/ranges.h>

#include <relidar/base/math.hpp>

#include "base/fail.hpp"

namespace relidar::packets {
namespace {

constexpr int kMostFirings = 40000;  // more than in a revolution of two seconds
constexpr std::int64_t kMaxRevolution_ns = 2000000000;
// PacketIndexEntry stores the index of a packet in its message in 16 bits.
constexpr std::size_t kMostInMessage = 0xFFFF;
// Revolutions begin at the rear, so that no scan is split in front of the vehicle.
constexpr double kRear_deg = 180.0;
// Largest 16-bit reflectivity, in units of 1/255: bin of the histogram of intensities.
constexpr double kMaxIntensityBin = 65535.0;
// A larger azimuth step between two firings means that the sensor skips a sector.
constexpr double kMinAzimuthJump_deg = 5.0;
// The user gets a note about an incomplete revolution at the start or end of the
// recording only if more than this fraction of it was recorded.
constexpr double kCutOff = 0.02;

// A column beyond one end of the range image continues at the other end.
bool is_enabled(const std::vector<bool>& column_is_enabled, std::int64_t column) {
    const auto n = std::int64_t(column_is_enabled.size());
    return column_is_enabled[std::size_t((column % n + n) % n)];
}

/// Extends a range of head azimuths by the adjacent columns at which the sensor never
/// fires. Columns count from the rear.
std::pair<double, double> extend_to_firings(const std::vector<bool>& column_is_enabled, double first_deg,
                                            double last_deg) {
    const std::size_t n = column_is_enabled.size();
    const double step_deg = 360.0 / double(n);
    std::int64_t begin = std::llround((first_deg - kRear_deg) / step_deg);
    std::int64_t end = std::llround((last_deg - kRear_deg) / step_deg) + 1;
    for (std::size_t k = 0; k < n && !is_enabled(column_is_enabled, begin - 1); ++k) --begin;
    for (std::size_t k = 0; k < n && !is_enabled(column_is_enabled, end); ++k) ++end;
    return {kRear_deg + step_deg * double(begin), kRear_deg + step_deg * double(end)};
}

}  // namespace

void PacketIndex::add_packets(const std::vector<ReceivedPacket>& packets, std::int64_t recording_time_ns,
                              const bag::MessagePosition& message_position,
                              const DecoderCalibration& calibration) {
    messages_.push_back({message_position, recording_time_ns});
    // The packets of an RS-LiDAR-16 do not state their number of returns, so the first
    // message decides.
    DecoderCalibration first_calibration = calibration;
    first_calibration.has_two_returns = !product_ && is_dual_rs16(packets);
    if (packets.size() > kMostInMessage)
        fail("a message has {} packets, expected at most {}", packets.size(), kMostInMessage);
    for (std::size_t i = 0; i < packets.size(); ++i) {
        set_product(packets[i], first_calibration);
        index_packet(packets[i], std::uint16_t(i));
    }
}

/// Creates the decoder for the product of the first packet. Throws if a later packet
/// comes from another product.
void PacketIndex::set_product(const ReceivedPacket& packet, const DecoderCalibration& calibration) {
    if (product_ && product_ == find_product(packet.bytes, calibration_)) return;
    const LidarProduct* product = find_product(packet.bytes, calibration);
    if (product_)
        fail("found a packet of {} bytes from {}, expected packets of a {} like before", packet.bytes.size(),
             product ? product->name : "an unknown product", product_->name);
    if (!product || !product->make) throw DataError(unsupported_text(product, packet.bytes));
    decoder_ = product->make(product->name, calibration);
    product_ = product;
    calibration_ = calibration;
}

/// Returns the azimuth step between two columns. Only for a sensor that fires at fixed
/// azimuths.
double PacketIndex::column_step_deg() const { return 360.0 / double(decoder_->timing().fires.size()); }

/// Decodes a packet and adds it to the index. If the sensor skips a sector within the
/// packet, adds an entry for each side, because time and azimuth jump there.
void PacketIndex::index_packet(const ReceivedPacket& packet_view, std::uint16_t index_in_message) {
    const DecodedPacket packet = decoder_->decode_packet(packet_view.bytes);
    if (packet.firings.empty()) {
        ++n_empty_;
        return;
    }
    n_slots_ = packet.n_slots;
    const std::size_t n = packet.firings.size();
    const bool may_skip = decoder_->timing().fires.empty();
    // azimuth step from firing f to the next firing
    const auto step_deg = [&](std::size_t f) {
        return rotation_deg(packet.firings[f].azimuth_deg, packet.firings[f + 1].azimuth_deg);
    };
    const auto skips_after = [&](std::size_t f) {
        return may_skip && f + 1 < n && step_deg(f) > kMinAzimuthJump_deg;
    };
    // Width of the sectors between the time stamp and the current entry. It is negative
    // if the sectors follow the entry, because the time stamp refers to the last firing.
    double skipped_deg = 0.0;
    // `after_us` counts from the time stamp. The stamp is at the end if it is nearer to
    // the last firing than to the first.
    const bool is_stamp_at_end = packet.firings.back().after_us < -packet.firings.front().after_us;
    for (std::size_t f = 0; is_stamp_at_end && f < n; ++f)
        if (skips_after(f)) skipped_deg -= step_deg(f);

    std::size_t first = 0;  // firing of the current entry
    for (std::size_t f = 0; f < n; ++f) {
        const bool is_last = f + 1 == n;
        if (!is_last && !skips_after(f)) continue;
        const LaserFiring& begin = packet.firings[first];
        const std::int64_t after_ns = std::llround(1e3 * begin.after_us);
        const int begin_slot = first == 0 && may_skip ? 0 : begin.slot;
        const int end_slot = is_last ? n_slots_ : packet.firings[f + 1].slot;
        Entry entry{.stamp_ns = packet_view.stamp_ns + after_ns,
                    .clock_ns = packet.clock_ns + after_ns,
                    .azimuth_deg = begin.azimuth_deg,
                    .turned_deg = 0.0f,
                    .skipped_deg = float(skipped_deg),
                    .message = std::uint32_t(messages_.size() - 1),
                    .in_message = index_in_message,
                    .first_firing = std::uint16_t(first),
                    .n_firings = std::uint16_t(f + 1 - first),
                    .first_slot = std::int16_t(begin.slot),
                    .n_slots = std::int16_t(end_slot - begin_slot),
                    .hash = std::uint32_t(std::hash<std::string_view>()(packet_view.bytes)),
                    .n_empty_before = n_empty_};
        n_empty_ = 0;
        for (std::size_t k = first; k < f; ++k) entry.turned_deg += float(step_deg(k));
        unwrap_clock(entry);
        packets_.push_back(entry);
        if (skips_after(f)) skipped_deg += step_deg(f);
        first = f + 1;
    }
    if (decoder_->timing().is_wide) count_intensities(packet);
}

/// Makes the sensor's clock continue the clock of the previous entry. The time stamps of
/// the packets show how often the clock has restarted.
void PacketIndex::unwrap_clock(Entry& entry) const {
    const double wrap_us = decoder_->timing().wrap_us;
    if (packets_.empty() || !(wrap_us > 0.0)) return;
    const Entry& before = packets_.back();
    const double passed_stamp_us = 1e-3 * double(entry.stamp_ns - before.stamp_ns),
                 passed_us = 1e-3 * double(entry.clock_ns - before.clock_ns);
    entry.clock_ns += std::llround(1e3 * wrap_us * std::round((passed_stamp_us - passed_us) / wrap_us));
}

/// Adds the returns of a packet to the histogram of intensities, whose bins are 1/255
/// wide. Intensities above 1 are later divided by a percentile of this histogram.
void PacketIndex::count_intensities(const DecodedPacket& packet) {
    n_returns_of_bin_.resize(kMaxIntensityBin + 1);
    for (const auto& returns : packet.echoes)
        for (const DecodedReturn& echo : returns) {
            const bool has_return = echo.range_m > 0.0f;
            if (!has_return) continue;
            const double bin = std::clamp(std::round(255.0 * double(echo.intensity)), 0.0, kMaxIntensityBin);
            ++n_returns_of_bin_[std::size_t(bin)];
            highest_bin_ = std::max(highest_bin_, bin);
        }
}

void PacketIndex::finish() {
    if (packets_.empty()) return;
    // Azimuths can only be unwrapped in the order of sending. The skipped sector and the
    // revolutions are then found from continuous azimuths.
    faults_ = sort_packets(packets_);
    n_packets_ = std::size_t(std::ranges::count(packets_, 0, &Entry::first_firing));
    const FiringTiming& timing = decoder_->timing();
    deg_us_ = unwrap_azimuths(packets_, timing);
    if (timing.fires.empty() && deg_us_ > 0.0)
        skipped_ = find_skipped_sector(packets_, deg_us_ * timing.cycle_us);
    find_revolutions();
}

/// Returns the number of packets that were lost before this packet. Does not count
/// packets without a firing, because the sensor may not send them.
std::size_t PacketIndex::count_lost_packets(std::size_t packet_index) const {
    const Entry &entry = packets_[packet_index], &before = packets_[packet_index - 1];
    if (!decoder_->timing().fires.empty()) return count_lost_columns(before, entry);
    // The elapsed time, without the time in which the head passes the skipped sector,
    // shows how many firings were lost. A slot is the time of one firing.
    const double cycle_us = decoder_->timing().cycle_us;
    const double skipped_deg = skipped_.overlap_deg(before.azimuth_deg, entry.azimuth_deg);
    const double skipped_slots = skipped_deg > 0.0 ? skipped_deg / (deg_us_ * cycle_us) : 0.0;
    const double elapsed_slots = 1e-3 * double(entry.clock_ns - before.clock_ns) / cycle_us;
    const double lost_slots = elapsed_slots - skipped_slots - before.n_slots;
    return std::size_t(std::clamp(std::round(lost_slots / double(n_slots_)), 0.0, 1e9));
}

/// Returns the number of packets with a firing that were lost between two packets, for a
/// sensor that fires at fixed azimuths. The azimuths show how many packets it has sent.
std::size_t PacketIndex::count_lost_columns(const Entry& before, const Entry& entry) const {
    const std::vector<bool>& fires = decoder_->timing().fires;
    // Each packet stores n_slots_ consecutive columns, beginning `first_slot` columns
    // before its azimuth. So the distance of the two packets gives the packets sent.
    const double n_sent = ((entry.azimuth_deg - before.azimuth_deg) / column_step_deg() - entry.first_slot +
                           before.first_slot) /
                          double(n_slots_);
    const std::size_t n_between = std::size_t(std::clamp(std::round(n_sent), 1.0, 1e9)) - 1;
    // After more than two revolutions, counts all packets, because the loop below would
    // be slow.
    if (n_between * std::size_t(n_slots_) > 2 * fires.size()) return n_between;
    std::int64_t first_column =  // of the packet, counted from the rear
        std::llround((before.azimuth_deg - kRear_deg) / column_step_deg()) - before.first_slot;
    std::size_t n_with_firing = 0;
    for (std::size_t k = 0; k < n_between; ++k) {
        first_column += n_slots_;
        bool has_firing = false;
        for (int slot = 0; slot < n_slots_; ++slot)
            has_firing = has_firing || is_enabled(fires, first_column + slot);
        if (has_firing) ++n_with_firing;
    }
    // A received packet without a firing is not lost.
    const std::size_t n_lost = n_between - std::min<std::size_t>(n_between, entry.n_empty_before);
    return std::min(n_with_firing, n_lost);
}

/// Counts the lost packets of a revolution. If packets were lost at its start or end,
/// counts only the part that belongs to this revolution.
void PacketIndex::store_lost_packets(PacketRevolution& revolution) const {
    double n_missing = 0.0;
    const double firing_step_deg = deg_us_ * decoder_->timing().cycle_us;
    // The packet after the revolution shows the losses at the end.
    const std::size_t last_tested = std::min(revolution.last + 1, packets_.size() - 1);
    for (std::size_t i = revolution.first + 1; i <= last_tested; ++i) {
        const Entry& before = packets_[i - 1];
        // The lost packets are evenly spread over the gap between the two packets.
        const double from_deg = before.azimuth_deg + double(before.turned_deg) + firing_step_deg;
        const double to_deg = packets_[i].azimuth_deg, gap_deg = std::max(to_deg - from_deg, 1e-6);
        const double within_deg =
            std::min(to_deg, revolution.begin_deg + 360.0) - std::max(from_deg, revolution.begin_deg);
        n_missing += double(count_lost_packets(i)) * std::clamp(within_deg / gap_deg, 0.0, 1.0);
    }
    revolution.n_missing = std::size_t(std::llround(n_missing));
    revolution.has_gaps = n_missing > 0.0;
}

/// Returns the range of head azimuths that were recorded, from start to end. Includes
/// azimuths just before and after it at which the sensor never fires, because no packets
/// are missing there.
std::pair<double, double> PacketIndex::azimuth_range_deg() const {
    const FiringTiming& timing = decoder_->timing();
    const double first_deg = packets_.front().azimuth_deg, begin_of_last_deg = packets_.back().azimuth_deg;
    const double last_deg = begin_of_last_deg + double(packets_.back().turned_deg);
    const bool fires_at_fixed_azimuths = !timing.fires.empty();
    if (fires_at_fixed_azimuths) return extend_to_firings(timing.fires, first_deg, last_deg);
    const bool has_skipped_sector = skipped_.width_deg > 0.0;
    if (!has_skipped_sector) return {first_deg, begin_of_last_deg};
    // Includes the skipped sector if the recording starts or ends within the rotation of
    // one firing cycle of it. The sector begins one cycle after the last firing.
    const double cycle_deg = deg_us_ * timing.cycle_us;
    const bool starts_behind = skipped_.overlap_deg(first_deg - cycle_deg, first_deg) > 0.0;
    const bool ends_before = skipped_.overlap_deg(last_deg, last_deg + 2.0 * cycle_deg) > 0.0;
    return {first_deg - (starts_behind ? skipped_.width_deg : 0.0),
            ends_before ? last_deg + skipped_.width_deg : begin_of_last_deg};
}

/// Returns the index of the first packet that begins after an azimuth.
std::size_t PacketIndex::packet_behind(double azimuth_deg) const {
    return std::size_t(std::ranges::upper_bound(packets_, azimuth_deg, {}, &Entry::azimuth_deg) -
                       packets_.begin());
}

/// Returns the revolution that begins at an azimuth, with its first and last packet. Its
/// first packet can begin before the revolution.
PacketRevolution PacketIndex::make_revolution(double begin_deg) const {
    PacketRevolution revolution{.first = std::max(packet_behind(begin_deg), std::size_t(1)) - 1,
                                .last = packet_behind(begin_deg + 360.0) - 1,
                                .begin_deg = begin_deg};
    // The second firing sequence of the last column can be in the next packet.
    if (decoder_->timing().n_sequences > 1)
        revolution.last = std::min(revolution.last + 1, packets_.size() - 1);
    return revolution;
}

/// Divides the recording into revolutions that begin when the head faces backward, and
/// keeps the usable ones. Counts the others by reason for the notes.
void PacketIndex::find_revolutions() {
    const auto [first_deg, end_deg] = azimuth_range_deg();
    double begin_deg = kRear_deg + 360.0 * std::ceil((first_deg - kRear_deg) / 360.0);
    const auto is_cut_off = [&](double from_deg, double to_deg) {
        return to_deg - from_deg - skipped_.overlap_deg(from_deg, to_deg) > 360.0 * kCutOff;
    };
    if (is_cut_off(first_deg, begin_deg)) ++left_out_.n_cut_off;
    for (; begin_deg + 360.0 <= end_deg; begin_deg += 360.0) {
        PacketRevolution revolution = make_revolution(begin_deg);
        const bool are_all_lost = revolution.first == revolution.last;
        if (are_all_lost) {
            // Continues with the revolution of the next packet.
            const std::size_t next = std::min(packet_behind(begin_deg + 360.0), packets_.size() - 1);
            const double next_turn = std::floor((packets_[next].azimuth_deg - kRear_deg) / 360.0);
            const double last_lost_deg = std::max(begin_deg, kRear_deg + 360.0 * (next_turn - 1.0));
            left_out_.n_lost += std::size_t(std::llround((last_lost_deg - begin_deg) / 360.0)) + 1;
            begin_deg = last_lost_deg;
            continue;
        }
        store_lost_packets(revolution);
        set_times(revolution);
        // Half as many lost as received packets means that a third of all packets is
        // missing.
        if (2 * revolution.n_missing >= revolution.last - revolution.first) ++left_out_.n_lost;
        else if (!has_steady_clock(revolution)) ++left_out_.n_jumps;
        else revolutions_.push_back(revolution);
    }
    if (is_cut_off(begin_deg, end_deg)) ++left_out_.n_cut_off;
}

std::string PacketIndex::describe_faults() const {
    std::vector<std::string> texts;
    const auto add = [&](std::size_t count, const char* text) {
        if (count > 0) texts.push_back(fmt::format("{} {}", count, text));
    };
    add(faults_.n_repeated, "packets were received twice");
    add(faults_.n_late, "packets were received out of order and are sorted by the clock of the sensor");
    const double all_deg =
        packets_.back().azimuth_deg + double(packets_.back().turned_deg) - packets_.front().azimuth_deg;
    if (revolutions_.empty() && all_deg < 360.0)
        texts.push_back(fmt::format("the packets cover only {:.0f} degrees of a revolution, expected 360",
                                    std::max(all_deg, 0.0)));
    else
        add(left_out_.n_cut_off, "revolutions are skipped, because the recording begins or ends during them");
    add(left_out_.n_lost, "revolutions are skipped, because at least a third of their packets is missing");
    add(left_out_.n_jumps,
        "revolutions are skipped, because the clock of the sensor jumps during them, or because packets of "
        "two sensors are mixed");
    if (skipped_.width_deg > 0.0)
        texts.push_back(fmt::format(
            "the sensor fires in {:.0f} degrees of a revolution, so the other {:.0f} degrees have no rays",
            360.0 - skipped_.width_deg, skipped_.width_deg));
    return fmt::format("{}", fmt::join(texts, "; "));
}

/// Sets `forward_ns` (when the head faces forward), `log_ns` (when the packet of that
/// moment was recorded) and `stamp_less_clock_ns` (time stamp minus sensor clock). If the
/// sensor fires at fixed azimuths, `forward_ns` is the time on the sensor's clock plus
/// this offset. For a clock that wraps, the offset is at most half of the interval.
void PacketIndex::set_times(PacketRevolution& revolution) const {
    // Interpolates between the packets before and after this moment.
    const double forward_deg = revolution.begin_deg + 180.0;
    const std::size_t k = std::clamp(packet_behind(forward_deg), std::size_t(1), packets_.size() - 1);
    const Entry &before = packets_[k - 1], &after = packets_[k];
    const double share =
        (forward_deg - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
    revolution.forward_ns = before.stamp_ns + std::int64_t(share * double(after.clock_ns - before.clock_ns));
    revolution.log_ns = messages_[before.message].log_ns;
    const FiringTiming& timing = decoder_->timing();
    const std::int64_t offset_before_ns = before.stamp_ns - before.clock_ns;
    const bool fires_at_fixed_azimuths = !timing.fires.empty();
    if (!fires_at_fixed_azimuths) {
        if (timing.wrap_us > 0.0)
            revolution.stamp_less_clock_ns =
                std::llround(std::remainder(double(offset_before_ns), 1e3 * timing.wrap_us));
        return;
    }
    // A network delay makes a time stamp later. So the smallest offset shows the
    // difference between the clocks best.
    revolution.stamp_less_clock_ns = offset_before_ns;
    for (std::size_t i = revolution.first; i <= revolution.last; ++i)
        revolution.stamp_less_clock_ns =
            std::min(revolution.stamp_less_clock_ns, packets_[i].stamp_ns - packets_[i].clock_ns);
    revolution.forward_ns += revolution.stamp_less_clock_ns - offset_before_ns;
}

/// Returns true if the sensor's clock advances in each packet by at least half of the
/// nominal time. Returns false if the revolution is too long.
bool PacketIndex::has_steady_clock(const PacketRevolution& revolution) const {
    const double slot_ns = 1e3 * decoder_->timing().cycle_us;
    for (std::size_t i = revolution.first + 1; i <= revolution.last; ++i) {
        const Entry &entry = packets_[i], &before = packets_[i - 1];
        if (double(entry.clock_ns - before.clock_ns) < 0.5 * slot_ns * before.n_slots) return false;
    }
    return packets_[revolution.last].clock_ns - packets_[revolution.first].clock_ns <= kMaxRevolution_ns;
}

/// Returns the first and the last message that contain packets of a revolution. Packets
/// are sorted by time, but their messages can be in another order.
std::pair<std::uint32_t, std::uint32_t> PacketIndex::message_range(const PacketRevolution& revolution) const {
    const auto packets =
        std::span(packets_).subspan(revolution.first, revolution.last + 1 - revolution.first);
    const auto [first, last] = std::ranges::minmax(packets, {}, &Entry::message);
    return {first.message, last.message};
}

std::vector<PacketIndex::MessageSource> PacketIndex::messages_of(const PacketRevolution& revolution) const {
    const auto [first, last] = message_range(revolution);
    return {messages_.begin() + first, messages_.begin() + last + 1};
}

/// Returns the mean azimuth step between two firings of a revolution, including lost
/// firings. Excludes the sector in which the sensor never fires.
double PacketIndex::mean_step_deg(const PacketRevolution& revolution) const {
    std::size_t n = 0;
    for (std::size_t i = revolution.first; i < revolution.last; ++i)
        n += std::size_t(packets_[i].n_slots) + count_lost_packets(i + 1) * std::size_t(n_slots_);
    const double first_deg = packets_[revolution.first].azimuth_deg,
                 last_deg = packets_[revolution.last].azimuth_deg;
    return std::max(last_deg - first_deg - skipped_.overlap_deg(first_deg, last_deg), 1.0) /
           double(std::max<std::size_t>(n, 1));
}

SpinningSensor PacketIndex::make_sensor() const {
    // deg_us_ is the mean rotation in degrees per microsecond.
    const double period_s = std::clamp(360e-6 / std::max(deg_us_, 1e-9), 0.02, 1.0);
    const FiringTiming& timing = decoder_->timing();
    // A sensor that fires at fixed azimuths has a fixed number of columns.
    if (!timing.fires.empty()) return decoder_->make_sensor(int(timing.fires.size()), 1.0 / period_s);
    // All firings of the revolution with the most firings must fit into the scan.
    double most = 1e6 * period_s / timing.cycle_us;
    for (const PacketRevolution& revolution : revolutions_)
        most = std::max(most, 360.0 / mean_step_deg(revolution));
    most /= double(timing.n_sequences);
    return decoder_->make_sensor(std::min(int(std::ceil(most)) + 1, kMostFirings), 1.0 / period_s);
}

/// Returns the value by which intensities are divided: 1 if no intensity exceeds 1 (bin
/// 255), otherwise the 99.5th percentile of all returns.
double PacketIndex::full_scale() const {
    if (highest_bin_ <= 255.0) return 1.0;
    std::uint64_t n_returns = 0;
    for (const std::uint32_t count : n_returns_of_bin_) n_returns += count;
    // Skips so many returns in the histogram, from the darkest.
    auto n_skipped = std::uint64_t(0.995 * double(n_returns - 1));
    std::size_t bin = 0;
    for (; n_returns_of_bin_[bin] <= n_skipped; ++bin) n_skipped -= n_returns_of_bin_[bin];
    return std::max(double(bin), 1.0) / 255.0;
}

std::string PacketIndex::describe_product() const {
    if (highest_bin_ <= 255.0) return decoder_->describe_product();
    return fmt::format("{}, reflectivities up to {:.4g} are divided by {:.4g}, their 99.5th percentile",
                       decoder_->describe_product(), highest_bin_, 255.0 * full_scale());
}

}  // namespace relidar::packets
