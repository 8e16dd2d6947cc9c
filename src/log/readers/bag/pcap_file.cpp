// SPDX-License-Identifier: Apache-2.0
// Reads network captures (pcap, pcapng) with libpcap. The packets of each LiDAR become a
// topic, named by the LiDAR's address and the destination port. Up to kRun packets of a
// topic form one message. The position of a message is the byte offset of its first
// packet in the file.
#include <pcap/pcap.h>

#include <algorithm>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/files.hpp"
#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/packets/decoder.hpp"
#include "log/readers/bag/packets/livox.hpp"
#include "log/readers/bag/packets/ouster.hpp"
#include "log/readers/bag/packets/packet_messages.hpp"
#include "log/readers/bag/part_file.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kRun = 64, kMostStreams = 256, kMostPending = 64, kMostDatagram = 65535;
constexpr unsigned kIpv4 = 0x0800, kUdp = 17;

unsigned big_endian(std::string_view bytes, std::size_t at) {
    return at + 2 <= bytes.size()
               ? static_cast<unsigned char>(bytes[at]) * 256u + static_cast<unsigned char>(bytes[at + 1])
               : 0u;
}
unsigned byte_at(std::string_view bytes, std::size_t at) {
    return at < bytes.size() ? static_cast<unsigned char>(bytes[at]) : 0u;
}

/// Returns the IPv4 packet in a network frame. Returns an empty view if the frame has
/// none.
std::string_view ip_packet(std::string_view frame, int link) {
    std::size_t head = 0;
    unsigned type = kIpv4;
    if (link == DLT_EN10MB) head = 14, type = big_endian(frame, 12);
    if (link == DLT_LINUX_SLL) head = 16, type = big_endian(frame, 14);
    if (link == DLT_LINUX_SLL2) head = 20, type = big_endian(frame, 0);
    if (link == DLT_NULL || link == DLT_LOOP) head = 4;
    // skips VLAN tags
    for (; type == 0x8100 || type == 0x88a8 || type == 0x9100; head += 4) type = big_endian(frame, head + 2);
    if (type != kIpv4 || frame.size() < head + 20 || byte_at(frame, head) >> 4 != 4) return {};
    const std::string_view packet = frame.substr(head);
    // removes the padding of the frame
    return packet.substr(0, std::max<std::size_t>(big_endian(packet, 2), 20));
}

/// A UDP datagram of a sensor.
struct Datagram {
    std::string source;  ///< sender's address and destination port: "192.168.1.201:2368"
    std::uint64_t at = 0;
    std::int64_t stamp_ns = 0;
    std::string bytes;
};

/// Joins the fragments of IPv4 packets. Senders transmit fragments in order, so one
/// incomplete packet per sender is stored.
class Fragments {
public:
    /// Adds an IPv4 packet or fragment.
    /// @return UDP header and payload, if they are complete
    std::optional<Datagram> add(std::string_view packet, std::uint64_t at, std::int64_t stamp_ns) {
        const std::size_t head = 4 * (byte_at(packet, 0) & 15);
        if (head < 20 || packet.size() < head || byte_at(packet, 9) != kUdp) return std::nullopt;
        const std::string_view payload = packet.substr(head);
        const unsigned flags = big_endian(packet, 6), id = big_endian(packet, 4);
        const std::size_t offset = 8 * (flags & 0x1fff);
        const bool more = flags & 0x2000;
        const std::string from = fmt::format("{}.{}.{}.{}", byte_at(packet, 12), byte_at(packet, 13),
                                             byte_at(packet, 14), byte_at(packet, 15));
        Datagram datagram{from, at, stamp_ns, std::string(payload)};
        if (offset == 0 && !more) return datagram;
        if (offset + payload.size() > kMostDatagram) return std::nullopt;
        const std::string sender(packet.substr(12, 8));
        if (!pending_.contains(sender) && pending_.size() >= kMostPending) pending_.clear();
        Pending& pending = pending_[sender];
        if (pending.id != id || pending.n == 0) pending = {id, 0, 0, {datagram.source, at, stamp_ns, {}}};
        std::string& bytes = pending.datagram.bytes;
        bytes.resize(std::max(bytes.size(), offset + payload.size()));
        std::copy(payload.begin(), payload.end(), bytes.begin() + std::ptrdiff_t(offset));
        pending.n += payload.size();
        if (!more) pending.total = offset + payload.size();
        if (pending.n != pending.total) return std::nullopt;
        datagram = std::move(pending.datagram);
        pending_.erase(sender);
        return datagram;
    }

private:
    struct Pending {
        unsigned id = 0;
        /// number of received bytes; total size, which the last fragment shows
        std::size_t n = 0, total = 0;
        Datagram datagram;
    };
    std::map<std::string, Pending> pending_;
};

struct ClosePcap {
    void operator()(pcap_t* pcap) const { pcap_close(pcap); }
};

class PcapFile : public BagFile {
public:
    explicit PcapFile(const std::filesystem::path& path) : path_(path), bytes_(PartFile(path).size()) {
        char why[PCAP_ERRBUF_SIZE] = "";
        pcap_.reset(pcap_open_offline_with_tstamp_precision(path.c_str(), PCAP_TSTAMP_PRECISION_NANO, why));
        if (!pcap_)
            throw DataError(fmt::format("{}: {}, expected a capture of packets (pcap or pcapng)",
                                        path.string(), excerpt(why)));
        link_ = pcap_datalink(pcap_.get());
        const std::vector<int> known = {DLT_EN10MB, DLT_LINUX_SLL, DLT_LINUX_SLL2, DLT_NULL,
                                        DLT_LOOP,   DLT_RAW,       DLT_IPV4};
        if (std::ranges::find(known, link_) == known.end())
            throw DataError(
                fmt::format("{}: captured on a link of type {}, expected Ethernet, Linux cooked or raw IP",
                            path.string(), link_));
        begin_ = position();
    }

    void each(TopicTable& topics, const Pass& pass) override {
        const std::lock_guard guard(lock_);
        std::vector<std::string> broken;
        ousters_ = packets::find_ouster_metadata(path_, broken);
        for (const std::string& text : broken) pass.note(text);
        streams_.clear();
        seek(begin_);
        n_cut_ = 0;
        Fragments fragments;
        while (const auto datagram = next(fragments, &pass)) {
            Stream* stream = stream_of(*datagram, topics);
            if (!stream) continue;
            pass.done(bytes_ > 0 ? double(datagram->at) / double(bytes_) : 0.0);
            if (stream->n++ == 0) stream->at = datagram->at, stream->log_ns = datagram->stamp_ns;
            if (stream->product) append_to(stream->run, *datagram);
            if (!stream->product && stream->n_of_bytes.size() < kMostPending)
                ++stream->n_of_bytes[payload(*datagram).size()];
            if (!stream->product || is_full(*stream, stream->n, datagram->stamp_ns - stream->log_ns))
                flush(*stream, pass);
        }
        for (auto& [key, stream] : streams_)
            if (stream.n > 0) flush(stream, pass);
        if (broken.empty() || !ousters_.empty()) note_unread_ousters(pass);
        if (n_cut_ > 0)
            pass.note(fmt::format("{}: the capture cut {} frames short: what they held is missing",
                                  path_.string(), n_cut_));
    }

    SharedBytes read(const Place& place) const override {
        const std::lock_guard guard(lock_);
        const auto stream = std::ranges::find_if(
            streams_, [&](const auto& keyed) { return keyed.second.number == place.in_chunk; });
        if (stream == streams_.end()) throw DataError("a stream that is not there any more");
        seek(place.at);
        Fragments fragments;
        std::string run;
        std::int64_t first_ns = 0;
        for (std::size_t n = 0; const auto datagram = next(fragments, nullptr);) {
            if (key_of(*datagram) != stream->first) continue;
            if (n++ == 0) first_ns = datagram->stamp_ns;
            append_to(run, *datagram);
            if (is_full(stream->second, n, datagram->stamp_ns - first_ns)) break;
        }
        return share_bytes(message_of(stream->second, std::move(run)));
    }

private:
    /// Sender with destination port, and product. The product is null if the datagrams
    /// are not LiDAR packets.
    using Key = std::pair<std::string, const packets::Product*>;
    struct Stream {
        std::size_t topic = 0;
        std::uint64_t number = 0;
        const packets::Product* product = nullptr;
        std::string run;
        std::size_t n = 0;
        std::uint64_t at = 0;
        std::int64_t log_ns = 0;
        /// number of datagrams for each size in bytes; only for unknown products
        std::map<std::size_t, std::size_t> n_of_bytes;
        std::shared_ptr<const packets::OusterFormat> ouster;  ///< metadata of the sensor
        std::string livox_frame;  ///< frame of the clouds of a Livox; empty for other products
    };
    packets::OusterFormats ousters_;  ///< metadata in files next to the capture
    const std::filesystem::path path_;
    const std::uint64_t bytes_;
    std::unique_ptr<pcap_t, ClosePcap> pcap_;
    int link_ = 0;
    std::uint64_t begin_ = 0;
    std::map<Key, Stream> streams_;
    mutable std::size_t n_cut_ = 0;
    mutable std::mutex lock_;  ///< protects the position in the file

    static std::string_view payload(const Datagram& datagram) {
        return std::string_view(datagram.bytes).substr(8);
    }
    static void append_to(std::string& run, const Datagram& datagram) {
        append(run, datagram.stamp_ns);
        append(run, std::uint32_t(datagram.bytes.size() - 8));
        run.append(payload(datagram));
    }
    std::uint64_t position() const {
        return std::uint64_t(std::max<off_t>(ftello(pcap_file(pcap_.get())), 0));
    }
    void seek(std::uint64_t at) const {
        if (fseeko(pcap_file(pcap_.get()), off_t(at), SEEK_SET) != 0)
            throw DataError(fmt::format("{}: byte {} cannot be reached", path_.string(), at));
    }

    /// Reads the next UDP datagram from the file. The result includes the UDP header.
    /// @param pass  receives a note if the file is truncated
    std::optional<Datagram> next(Fragments& fragments, const Pass* pass) const {
        for (;;) {
            const std::uint64_t at = position();
            pcap_pkthdr* head = nullptr;
            const unsigned char* data = nullptr;
            const int code = pcap_next_ex(pcap_.get(), &head, &data);
            if (code == PCAP_ERROR && pass)
                pass->note(fmt::format("{}: {}: packets behind byte {} are missing", path_.string(),
                                       excerpt(pcap_geterr(pcap_.get())), at));
            if (code != 1) return std::nullopt;
            if (head->caplen < head->len) {
                ++n_cut_;
                continue;
            }
            const std::string_view frame(reinterpret_cast<const char*>(data), head->caplen);
            // libpcap was opened with nanosecond precision, so tv_usec has nanoseconds
            const std::int64_t stamp_ns = std::int64_t(head->ts.tv_sec) * 1000000000 + head->ts.tv_usec;
            auto datagram = fragments.add(ip_packet(frame, link_), at, stamp_ns);
            if (!datagram || datagram->bytes.size() < 8) continue;
            const unsigned length = big_endian(datagram->bytes, 4);
            if (length < 8 || length > datagram->bytes.size()) continue;
            datagram->bytes.resize(length);
            datagram->source += fmt::format(":{}", big_endian(datagram->bytes, 2));
            return datagram;
        }
    }

    std::shared_ptr<const packets::OusterFormat> ouster_of(const Datagram& datagram) const {
        return packets::format_of(ousters_, datagram.source, payload(datagram));
    }
    Key key_of(const Datagram& datagram) const {
        return {datagram.source, packets::find_product(payload(datagram), {{}, ouster_of(datagram)})};
    }

    /// Adds notes about packets that are probably from an Ouster but cannot be decoded.
    /// They have a size that Ouster sensors send or that the metadata states. Also notes
    /// two senders with the same metadata.
    void note_unread_ousters(const Pass& pass) const {
        std::map<const packets::OusterFormat*, std::string> senders;
        for (const auto& [key, stream] : streams_) {
            for (const auto& [size, n] : stream.n_of_bytes) {
                // copy, because clang 14 cannot capture a structured binding in a lambda
                const std::size_t bytes = size;
                const bool is_told = std::ranges::any_of(
                    ousters_, [&](const auto& format) { return format->packet_bytes == bytes; });
                if (n > 1 && (is_told || packets::is_ouster_size(bytes)))
                    pass.note(fmt::format("{}: {}", path_.string(),
                                          packets::ouster_text(ousters_, path_, key.first, bytes)));
            }
            if (!stream.ouster) continue;
            std::string& first = senders[stream.ouster.get()];
            if (!first.empty())
                pass.note(
                    fmt::format("{}: packets of {} and of {} are read by one sensor's metadata, {}, expected "
                                "one for each",
                                path_.string(), first, key.first, stream.ouster->where));
            first = key.first;
        }
    }

    Stream* stream_of(const Datagram& datagram, TopicTable& topics) {
        Key key = key_of(datagram);
        if (const auto known = streams_.find(key); known != streams_.end()) return &known->second;
        if (streams_.size() >= kMostStreams) return nullptr;
        Stream stream;
        stream.number = streams_.size();
        stream.product = key.second;
        if (stream.product) stream.ouster = ouster_of(datagram);
        if (packets::is_livox(payload(datagram))) stream.livox_frame = datagram.source;
        stream.topic =
            topics.number_of(stream.livox_frame.empty()
                                 ? Topic{datagram.source, stream.product ? packets::kDatagrams : "other UDP",
                                         packets::kDatagrams}
                                 : Topic{datagram.source, packets::kLivoxType, packets::kLivoxEncoding});
        return &streams_.emplace(std::move(key), std::move(stream)).first->second;
    }

    /// Returns true if a message of a stream is complete.
    /// @param n  number of datagrams in the message
    /// @param passed_ns  time from its first datagram to its last datagram
    static bool is_full(const Stream& stream, std::size_t n, std::int64_t passed_ns) {
        return stream.livox_frame.empty()
                   ? n == kRun
                   : passed_ns >= packets::kLivoxCloud_ns || n == packets::kMostLivoxPackets;
    }
    /// Converts datagrams to a message of the stream's topic.
    static std::string message_of(const Stream& stream, std::string run) {
        return stream.livox_frame.empty() ? run : packets::livox_cloud(run, stream.livox_frame);
    }

    void flush(Stream& stream, const Pass& pass) const {
        pass.take({stream.topic, stream.log_ns, message_of(stream, stream.run), {stream.at, stream.number}});
        stream.run.clear();
        stream.n = 0;
    }
};

}  // namespace

std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file) {
    return std::make_unique<PcapFile>(file);
}

}  // namespace relidar::bag
