// SPDX-License-Identifier: Apache-2.0
// Reads network captures (pcap, pcapng, also compressed with gzip) with libpcap. The
// packets of each LiDAR become a topic, whose name is the LiDAR's address and the
// destination port. A message contains up to kMinStreamPackets packets of a topic. The
// position of a message is the byte offset of its first packet in the file.
#include <arpa/inet.h>
#include <pcap/pcap.h>

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <tuple>
#include <vector>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/bag_file.hpp"
#include "read/bag/packet_messages.hpp"
#include "read/bag/part_file.hpp"
#include "read/packets/decoder.hpp"
#include "read/packets/ouster.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kMinStreamPackets = 64, kMaxStreams = 256, kMaxPending = 64, kMaxDatagramBytes = 65535;
constexpr unsigned kEtherIpv4 = 0x0800, kEtherIpv6 = 0x86dd, kUdpProtocol = 17;
// UDP header: source port, destination port, length with the header, and checksum
constexpr std::size_t kUdpHeaderBytes = 8, kUdpPortAt = 2, kUdpLengthAt = 4;
// A fragment that arrives later belongs to another datagram with the same identification.
constexpr std::int64_t kMaxFragmentGap_ns = 1000000000;

// Numbers of a packet. Bytes behind its end are 0.
unsigned byte_at(std::string_view bytes, std::size_t offset) {
    return offset < bytes.size() ? static_cast<unsigned char>(bytes[offset]) : 0u;
}
unsigned read_be16(std::string_view bytes, std::size_t offset) {
    return offset + 2 <= bytes.size() ? byte_at(bytes, offset) * 256u + byte_at(bytes, offset + 1) : 0u;
}

/// An unfragmented IP packet, or one fragment of an IP packet.
struct IpPacket {
    std::string from;        ///< address of the sender
    std::string key;         ///< bytes that only the fragments of one datagram share
    std::size_t offset = 0;  ///< byte offset of the fragment in the packet; 0 for an unfragmented packet
    bool has_more = false;   ///< true if more fragments follow this fragment
    std::string_view payload = {};
};

/// Returns the UDP packet or fragment in an IPv4 packet (RFC 791). Bytes of the header:
/// 0: its length in 4 bytes (low 4 bits), 2: length of the packet, 4: identification of
/// the datagram, 6: flags and fragment offset, 9: protocol, 12: sender, 16: receiver.
std::optional<IpPacket> parse_ipv4(std::string_view packet) {
    constexpr std::size_t kLeastHeader = 20;
    constexpr unsigned kMoreFragments = 0x2000, kOffsetMask = 0x1fff, kBytesPerOffset = 8;
    const std::size_t header_bytes = 4 * (byte_at(packet, 0) & 15);
    // Removes the padding of the Ethernet frame. Ignores a length of 0, because network
    // cards that split packets do not write the length.
    const std::size_t length = read_be16(packet, 2);
    if (length >= kLeastHeader) packet = packet.substr(0, length);
    if (header_bytes < kLeastHeader || packet.size() < header_bytes) return std::nullopt;
    if (byte_at(packet, 9) != kUdpProtocol) return std::nullopt;
    const unsigned flags = read_be16(packet, 6);
    return IpPacket{.from = fmt::format("{}.{}.{}.{}", byte_at(packet, 12), byte_at(packet, 13),
                                        byte_at(packet, 14), byte_at(packet, 15)),
                    .key = std::string(packet.substr(12, 8)).append(packet.substr(4, 2)),
                    .offset = std::size_t(kBytesPerOffset * (flags & kOffsetMask)),
                    .has_more = (flags & kMoreFragments) != 0,
                    .payload = packet.substr(header_bytes)};
}

/// Returns the UDP packet or fragment in an IPv6 packet (RFC 8200). Bytes of the header:
/// 4: length of the remainder, 6: type of the next header, 8: sender, 24: receiver.
/// Extension headers can precede the UDP header. They begin with the type of the next
/// header (byte 0) and their length (byte 1), in units of 8 bytes beyond the first 8.
std::optional<IpPacket> parse_ipv6(std::string_view packet) {
    constexpr std::size_t kIpv6HeaderBytes = 40, kFragmentHeaderBytes = 8;
    constexpr unsigned kFragmentHeader = 44, kHopByHopHeader = 0, kRoutingHeader = 43, kOptionsHeader = 60;
    if (packet.size() < kIpv6HeaderBytes) return std::nullopt;
    std::array<char, INET6_ADDRSTRLEN> sender{};
    inet_ntop(AF_INET6, packet.data() + 8, sender.data(), sender.size());
    IpPacket result{.from = fmt::format("[{}]", sender.data()), .key = std::string(packet.substr(8, 32))};
    unsigned header_type = byte_at(packet, 6);
    std::string_view rest = packet.substr(kIpv6HeaderBytes, read_be16(packet, 4));
    const auto is_extension = [](unsigned type) {
        return type == kHopByHopHeader || type == kRoutingHeader || type == kOptionsHeader ||
               type == kFragmentHeader;
    };
    while (is_extension(header_type)) {
        const bool is_fragment = header_type == kFragmentHeader;
        const std::size_t header_bytes = is_fragment ? kFragmentHeaderBytes : 8 * (1 + byte_at(rest, 1));
        if (rest.size() < header_bytes) return std::nullopt;
        if (is_fragment) {
            // bytes 2 and 3: offset of the fragment, in whole 8 bytes, and the bit "more"
            result.offset = read_be16(rest, 2) & 0xfff8;
            result.has_more = (read_be16(rest, 2) & 1) != 0;
            result.key.append(rest.substr(4, 4));  // identification of the datagram
        }
        header_type = byte_at(rest, 0);
        rest.remove_prefix(header_bytes);
    }
    if (header_type != kUdpProtocol) return std::nullopt;
    result.payload = rest;
    return result;
}

/// Size of the header of a frame, and byte offset of its EtherType.
struct LinkType {
    int link;
    std::size_t head, type_at;
};
constexpr std::size_t kNoType = std::size_t(-1);
constexpr LinkType kLinkTypes[] = {{DLT_EN10MB, 14, 12},   {DLT_LINUX_SLL, 16, 14}, {DLT_LINUX_SLL2, 20, 0},
                                   {DLT_NULL, 4, kNoType}, {DLT_LOOP, 4, kNoType},  {DLT_RAW, 0, kNoType},
                                   {DLT_IPV4, 0, kNoType}};

/// Returns the UDP packet in a captured network frame, if it has one.
/// @param link_type  in the table kLinkTypes
std::optional<IpPacket> parse_ip_packet(std::string_view network_frame, int link_type) {
    constexpr std::size_t kVlanTagBytes = 4, kLeastIpHeader = 20;
    const LinkType& link = *std::ranges::find(kLinkTypes, link_type, &LinkType::link);
    std::size_t header_bytes = link.head;
    unsigned type = link.type_at == kNoType ? 0 : read_be16(network_frame, link.type_at);
    const auto is_vlan_tag = [&] { return type == 0x8100 || type == 0x88a8 || type == 0x9100; };
    while (is_vlan_tag()) {
        type = read_be16(network_frame, header_bytes + 2);
        header_bytes += kVlanTagBytes;
    }
    if (network_frame.size() < header_bytes + kLeastIpHeader) return std::nullopt;
    const std::string_view packet = network_frame.substr(header_bytes);
    const unsigned version = byte_at(packet, 0) >> 4;
    if (version == 4 && (type == 0 || type == kEtherIpv4)) return parse_ipv4(packet);
    if (version == 6 && (type == 0 || type == kEtherIpv6)) return parse_ipv6(packet);
    return std::nullopt;
}

struct Datagram {
    std::string source;    ///< sender and destination port, for example "192.168.1.201:2368"
    std::uint64_t at = 0;  ///< byte offset of its first frame in the file
    std::int64_t stamp_ns = 0;
    std::string bytes;
};

/// Joins the fragments of datagrams. Fragments may arrive late, twice, or mixed with
/// fragments of other datagrams.
class IpReassembler {
public:
    /// Adds an IP packet or a fragment at byte `at` of the file.
    /// @return UDP header and payload, if all fragments of the datagram have been added
    std::optional<Datagram> add_fragment(const IpPacket& packet, std::uint64_t at, std::int64_t time_ns) {
        const std::string_view payload = packet.payload;
        const std::size_t payload_end = packet.offset + payload.size();
        if (packet.offset == 0 && !packet.has_more)
            return Datagram{packet.from, at, time_ns, std::string(payload)};
        if (payload_end > kMaxDatagramBytes) return std::nullopt;
        make_space(packet.key, time_ns);
        PendingDatagram& pending = pending_[packet.key];
        if (pending.parts.empty()) pending.datagram = {packet.from, at, time_ns, {}};
        std::string& bytes = pending.datagram.bytes;
        bytes.resize(std::max(bytes.size(), payload_end));
        std::ranges::copy(payload, bytes.begin() + std::ptrdiff_t(packet.offset));
        std::size_t& part_end = pending.parts[packet.offset];
        part_end = std::max(part_end, payload_end);
        if (!packet.has_more) pending.total = payload_end;
        if (!pending.is_complete()) return std::nullopt;
        Datagram datagram = std::move(pending.datagram);
        pending_.erase(packet.key);
        return datagram;
    }

private:
    struct PendingDatagram {
        std::map<std::size_t, std::size_t> parts;  ///< end of each received fragment, by its byte offset
        std::size_t total = 0;  ///< size of the datagram; known when the last fragment has been received
        Datagram datagram;

        bool is_complete() const {
            std::size_t received = 0;  // bytes without a gap from the start
            for (const auto& [offset, part_end] : parts)
                if (offset <= received) received = std::max(received, part_end);
            return total != 0 && received == total;
        }
    };
    std::map<std::string, PendingDatagram> pending_;  ///< by IpPacket::key

    /// Erases old datagrams, because identifications are reused. Erases the oldest one if
    /// a new datagram would be one too many.
    void make_space(const std::string& key, std::int64_t time_ns) {
        std::erase_if(pending_, [&](const auto& entry) {
            return std::abs(time_ns - entry.second.datagram.stamp_ns) > kMaxFragmentGap_ns;
        });
        if (pending_.contains(key) || pending_.size() < kMaxPending) return;
        pending_.erase(std::ranges::min_element(pending_, {},
                                                [](const auto& entry) { return entry.second.datagram.at; }));
    }
};

struct ClosePcap {
    void operator()(pcap_t* pcap) const { pcap_close(pcap); }
};

/// A network capture, read with libpcap.
class PcapFile : public BagFile {
public:
    PcapFile(const std::filesystem::path& file, const std::filesystem::path& name) : path_(name) {
        char why[PCAP_ERRBUF_SIZE] = "";
        pcap_.reset(pcap_open_offline_with_tstamp_precision(file.c_str(), PCAP_TSTAMP_PRECISION_NANO, why));
        if (!pcap_)
            fail("{}: cannot read the capture ({}), expected packets in the format pcap or pcapng",
                 path_.string(), quote(why));
        link_ = pcap_datalink(pcap_.get());
        if (std::ranges::find(kLinkTypes, link_, &LinkType::link) == std::end(kLinkTypes))
            fail("{}: found packets of link type {}, expected Ethernet, Linux cooked or raw IP",
                 path_.string(), link_);
        begin_ = tell();
        bytes_ = std::filesystem::file_size(file);
    }

    void read_messages(TopicTable& topics, const ReadCallbacks& callbacks) override {
        const std::lock_guard guard(lock_);
        std::vector<std::string> broken;
        ousters_ = packets::read_metadata_files(strip_packed(path_), broken);
        for (const std::string& text : broken) callbacks.note(text);
        streams_.clear();
        seek_to_byte(begin_);
        n_cut_ = 0;
        IpReassembler fragments;
        while (const auto datagram = read_datagram(fragments, &callbacks)) {
            CaptureStream* stream = find_stream(*datagram, topics);
            if (!stream) continue;
            callbacks.done(bytes_ > 0 ? double(datagram->at) / double(bytes_) : 0.0);
            add_datagram(*stream, *datagram, callbacks);
        }
        for (auto& [key, stream] : streams_)
            if (stream.n_datagrams > 0) emit_message(stream, callbacks);
        if (broken.empty() || !ousters_.empty()) report_undecoded(callbacks);
        if (n_cut_ > 0)
            callbacks.note(
                fmt::format("{}: {} packets were truncated during the capture; their data is missing",
                            path_.string(), n_cut_));
    }

    SharedBytes read_message(const MessagePosition& place) const override {
        const std::lock_guard guard(lock_);
        const auto entry = std::ranges::find_if(
            streams_, [&](const auto& candidate) { return candidate.second.number == place.in_chunk; });
        if (entry == streams_.end())
            fail("the capture file changed while it was read: one of its packet streams is missing");
        const auto& [key, stream] = *entry;
        // Reading starts at `place.at`. The first complete datagram may start later.
        const auto late = stream.late_messages.find(place.at);
        const std::uint64_t first_at = late == stream.late_messages.end() ? place.at : late->second;
        seek_to_byte(place.at);
        IpReassembler fragments;
        std::string bytes;
        std::size_t n_datagrams = 0;
        std::int64_t first_ns = 0;
        while (const auto datagram = read_datagram(fragments, nullptr)) {
            const bool is_before_message = n_datagrams == 0 && datagram->at != first_at;
            if (make_stream_key(*datagram) != key || is_before_message) continue;
            if (is_after_pause(stream, n_datagrams, datagram->stamp_ns - first_ns)) break;
            if (n_datagrams == 0) first_ns = datagram->stamp_ns;
            ++n_datagrams;
            append_datagram(bytes, *datagram);
            if (is_complete(stream, n_datagrams, datagram->stamp_ns - first_ns)) break;
        }
        return share_bytes(encode_message(stream, std::move(bytes)));
    }

private:
    /// Sender and destination port, LiDAR product, and metadata of an Ouster. The product
    /// is null for datagrams that are not LiDAR packets.
    using CaptureStreamKey =
        std::tuple<std::string, const packets::LidarProduct*, const packets::OusterMetadata*>;
    /// Datagrams of one sender. Consecutive datagrams are collected to a message.
    struct CaptureStream {
        std::size_t topic = 0;
        std::uint64_t number = 0;  ///< identifies the stream in MessagePosition::in_chunk
        const packets::LidarProduct* product = nullptr;
        std::string bytes;            ///< datagrams of the current message
        std::size_t n_datagrams = 0;  ///< number of datagrams of the current message
        /// Byte offsets of a message, whose IP fragments can be mixed: the earliest start
        /// of a datagram, where reading begins, and the start of the first complete
        /// datagram.
        std::uint64_t at = 0, first_at = 0;
        std::int64_t log_ns = 0;  ///< time of the first datagram of the current message
        /// `first_at` by `at`, for messages in which they differ.
        std::map<std::uint64_t, std::uint64_t> late_messages;
        /// Number of datagrams of each size, for streams of unknown products.
        std::map<std::size_t, std::size_t> n_of_bytes;
        std::shared_ptr<const packets::OusterMetadata> ouster;  ///< metadata of the sensor
        std::string livox_frame;  ///< frame name of the clouds of a Livox; empty for other products
    };
    packets::MetadataList ousters_;  ///< metadata from files in the folder of the capture
    const std::filesystem::path path_;
    std::uint64_t bytes_ = 0;  ///< size of the file
    std::unique_ptr<pcap_t, ClosePcap> pcap_;
    int link_ = 0;             ///< link type of the frames, see kLinkTypes
    std::uint64_t begin_ = 0;  ///< byte offset of the first frame
    std::map<CaptureStreamKey, CaptureStream> streams_;
    mutable std::size_t n_cut_ = 0;  ///< frames that were truncated during the capture
    mutable std::mutex lock_;        ///< protects the read position in the file

    static std::string_view payload_of(const Datagram& datagram) {
        return std::string_view(datagram.bytes).substr(kUdpHeaderBytes);
    }
    /// Appends time, size and payload of a datagram.
    static void append_datagram(std::string& message_bytes, const Datagram& datagram) {
        append_raw(message_bytes, datagram.stamp_ns);
        append_raw(message_bytes, std::uint32_t(payload_of(datagram).size()));
        message_bytes.append(payload_of(datagram));
    }
    /// Adds a datagram to the message of its stream. Emits complete messages.
    void add_datagram(CaptureStream& stream, const Datagram& datagram, const ReadCallbacks& callbacks) const {
        if (is_after_pause(stream, stream.n_datagrams, datagram.stamp_ns - stream.log_ns))
            emit_message(stream, callbacks);
        if (stream.n_datagrams == 0) {
            stream.at = stream.first_at = datagram.at;
            stream.log_ns = datagram.stamp_ns;
        }
        ++stream.n_datagrams;
        // Late fragments: a datagram that is complete later can start earlier.
        stream.at = std::min(stream.at, datagram.at);
        // Datagrams of unknown products are only counted, by their size.
        if (stream.product) append_datagram(stream.bytes, datagram);
        else if (stream.n_of_bytes.size() < kMaxPending) ++stream.n_of_bytes[payload_of(datagram).size()];
        if (!stream.product || is_complete(stream, stream.n_datagrams, datagram.stamp_ns - stream.log_ns))
            emit_message(stream, callbacks);
    }
    std::uint64_t tell() const { return std::uint64_t(std::max<off_t>(ftello(pcap_file(pcap_.get())), 0)); }
    void seek_to_byte(std::uint64_t file_offset) const {
        if (fseeko(pcap_file(pcap_.get()), off_t(file_offset), SEEK_SET) != 0)
            fail("{}: cannot read the file from byte {}", path_.string(), file_offset);
    }

    /// Reads the next UDP datagram of the file, with its UDP header.
    /// @param callbacks  receives a note if the file is truncated
    std::optional<Datagram> read_datagram(IpReassembler& reassembler, const ReadCallbacks* callbacks) const {
        for (;;) {
            const std::uint64_t at = tell();
            pcap_pkthdr* head = nullptr;
            const unsigned char* data = nullptr;
            const int code = pcap_next_ex(pcap_.get(), &head, &data);
            if (code == PCAP_ERROR && callbacks)
                callbacks->note(fmt::format("{}: {}; the packets after byte {} are missing", path_.string(),
                                            quote(pcap_geterr(pcap_.get())), at));
            if (code != 1) return std::nullopt;
            if (head->caplen < head->len) {
                ++n_cut_;
                continue;
            }
            constexpr std::int64_t kMaxTime_s = 4'000'000'000;  // later times are damaged
            const auto seconds = std::int64_t(head->ts.tv_sec);
            if (seconds < 0 || seconds > kMaxTime_s) continue;
            const std::string_view frame(reinterpret_cast<const char*>(data), head->caplen);
            // tv_usec contains nanoseconds: libpcap was opened with this precision.
            const std::int64_t stamp_ns = seconds * 1000000000 + head->ts.tv_usec;
            const std::optional<IpPacket> packet = parse_ip_packet(frame, link_);
            if (!packet) continue;
            auto datagram = reassembler.add_fragment(*packet, at, stamp_ns);
            if (!datagram || datagram->bytes.size() < kUdpHeaderBytes) continue;
            const unsigned length = read_be16(datagram->bytes, kUdpLengthAt);
            if (length < kUdpHeaderBytes || length > datagram->bytes.size()) continue;
            datagram->bytes.resize(length);  // removes padding
            datagram->source += fmt::format(":{}", read_be16(datagram->bytes, kUdpPortAt));
            return datagram;
        }
    }

    std::shared_ptr<const packets::OusterMetadata> metadata_of(const Datagram& datagram) const {
        return packets::find_metadata(ousters_, datagram.source, payload_of(datagram));
    }
    CaptureStreamKey make_stream_key(const Datagram& datagram) const {
        const auto ouster = metadata_of(datagram);
        return {datagram.source, packets::find_product(payload_of(datagram), {{}, ouster}), ouster.get()};
    }

    /// Adds notes about packets that cannot be decoded, although they have the size of
    /// Ouster packets. Also notes two sensors that match the same metadata.
    void report_undecoded(const ReadCallbacks& callbacks) const {
        std::map<const packets::OusterMetadata*, std::string> senders;
        for (const auto& [key, stream] : streams_) {
            for (const auto& [size, n] : stream.n_of_bytes) {
                // copy, because clang 14 cannot capture a structured binding in a lambda
                const std::size_t bytes = size;
                const bool has_matching_metadata = std::ranges::any_of(
                    ousters_, [&](const auto& format) { return format->packet_bytes == bytes; });
                if (n > 1 && (has_matching_metadata || packets::is_ouster_size(bytes)))
                    callbacks.note(
                        fmt::format("{}: {}", path_.string(),
                                    packets::ouster_error(ousters_, path_, std::get<0>(key), bytes)));
            }
            if (!stream.ouster) continue;
            std::string& first = senders[stream.ouster.get()];
            if (!first.empty())
                callbacks.note(
                    fmt::format("{}: packets of {} and of {} use the same sensor metadata, {}, expected one "
                                "metadata file for each sensor",
                                path_.string(), first, std::get<0>(key), stream.ouster->where));
            first = std::get<0>(key);
        }
    }

    /// Returns the stream of a datagram, which becomes a topic. Creates it for the first
    /// datagram. Returns null if the capture has too many streams.
    CaptureStream* find_stream(const Datagram& datagram, TopicTable& topics) {
        CaptureStreamKey key = make_stream_key(datagram);
        if (const auto existing_stream = streams_.find(key); existing_stream != streams_.end())
            return &existing_stream->second;
        if (streams_.size() >= kMaxStreams) return nullptr;
        CaptureStream stream;
        stream.number = streams_.size();
        stream.product = std::get<1>(key);
        if (stream.product) stream.ouster = metadata_of(datagram);
        if (packets::is_livox_packet(payload_of(datagram))) stream.livox_frame = datagram.source;
        std::string name = datagram.source;
        // Two Ousters can use the same address and port. The serial number in the topic's
        // name distinguishes them.
        for (const auto& [other, known] : streams_)
            if (stream.ouster && known.ouster && std::get<0>(other) == datagram.source)
                name = fmt::format("{} ({})", datagram.source, stream.ouster->serial);
        stream.topic = topics.topic_index(
            stream.livox_frame.empty()
                ? BagTopic{std::move(name), stream.product ? kLidarDatagrams : kOtherDatagrams,
                           kLidarDatagrams}
                : BagTopic{std::move(name), packets::kLivoxType, packets::kLivoxEncoding});
        return &streams_.emplace(std::move(key), std::move(stream)).first->second;
    }

    /// Returns true if a message is complete. A Livox sends no revolutions, so its
    /// messages last a fixed time. Other messages have a fixed number of datagrams.
    /// @param elapsed_ns  time from the first to the last datagram
    static bool is_complete(const CaptureStream& stream, std::size_t n_datagrams, std::int64_t elapsed_ns) {
        if (stream.livox_frame.empty()) return n_datagrams == kMinStreamPackets;
        return elapsed_ns >= packets::kLivoxCloud_ns || n_datagrams == packets::kMostLivoxPackets;
    }
    /// A datagram of a Livox after a pause begins a new message.
    static bool is_after_pause(const CaptureStream& stream, std::size_t n_datagrams_in_message,
                               std::int64_t time_since_message_start_ns) {
        return n_datagrams_in_message > 0 && !stream.livox_frame.empty() &&
               time_since_message_start_ns >= 2 * packets::kLivoxCloud_ns;
    }
    /// Returns the bytes of a message. The packets of a Livox become a cloud.
    static std::string encode_message(const CaptureStream& stream, std::string datagram_bytes) {
        return stream.livox_frame.empty() ? datagram_bytes
                                          : packets::join_livox_packets(datagram_bytes, stream.livox_frame);
    }

    /// Passes the collected datagrams of a stream to the caller as one message.
    void emit_message(CaptureStream& stream, const ReadCallbacks& callbacks) const {
        if (stream.at != stream.first_at) stream.late_messages[stream.at] = stream.first_at;
        callbacks.message_callback(
            {stream.topic, stream.log_ns, encode_message(stream, stream.bytes), {stream.at, stream.number}});
        stream.bytes.clear();
        stream.n_datagrams = 0;
    }
};

}  // namespace

std::unique_ptr<BagFile> open_pcap_file(const std::filesystem::path& file,
                                        const std::filesystem::path& name) {
    return std::make_unique<PcapFile>(file, name);
}

}  // namespace relidar::bag
