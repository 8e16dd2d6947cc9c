// SPDX-License-Identifier: Apache-2.0
#include "http_session.hpp"

#include <algorithm>

#include <boost/beast/http/error.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/rfc7230.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/rfc6455.hpp>

#include "access.hpp"

namespace relidar::view {

namespace http = boost::beast::http;

namespace {

// Limits of discard_rest().
constexpr std::size_t kDiscardedAtOnce = 65536;
constexpr int kMaxDiscards = 16;
constexpr std::chrono::milliseconds kDiscardTime{500};

std::string_view to_view(boost::beast::string_view text) { return {text.data(), text.size()}; }

std::string_view url_path(std::string_view target) { return target.substr(0, target.find('?')); }
std::string_view url_query(std::string_view target) {
    const std::size_t mark = target.find('?');
    return mark == std::string_view::npos ? std::string_view{} : target.substr(mark + 1);
}

/// Returns the HTTP status for a request that cannot be parsed. No value if nothing
/// should be sent, because the client has closed the connection or the network failed.
std::optional<http::status> parse_status(const boost::system::error_code& parse_error) {
    if (parse_error == http::error::body_limit || parse_error == http::error::unexpected_body)
        return http::status::payload_too_large;
    if (parse_error == http::error::header_limit || parse_error == http::error::buffer_overflow)
        return http::status::request_header_fields_too_large;
    if (parse_error == http::error::end_of_stream) return {};
    // All other errors of the HTTP parser have this category.
    const bool is_parser_error =
        parse_error.category() == make_error_code(http::error::bad_method).category();
    return is_parser_error ? std::optional(http::status::bad_request) : std::nullopt;
}

}  // namespace

/// Takes over an accepted connection. read_request() or send_overload() starts it.
HttpSession::HttpSession(boost::asio::ip::tcp::socket socket, WebServerState& hub)
    : hub_(hub), counted_(hub), stream_(std::move(socket)), timer_(hub.io) {}

/// Starts a timer that cancels the current read or write if it takes too long. The weak
/// pointer lets the session end while the timer runs.
void HttpSession::start_timeout(std::chrono::milliseconds max_duration) {
    late_ = false;
    timer_.expires_after(max_duration);
    timer_.async_wait([weak = weak_from_this()](Error cancelled) {
        const auto self = weak.lock();
        if (cancelled || !self) return;
        self->late_ = true;
        self->stream_.cancel();
    });
}

void HttpSession::read_request() {
    parser_.emplace();
    parser_->header_limit(static_cast<std::uint32_t>(hub_.options.max_header_bytes));
    parser_->body_limit(0);  // Rejects requests with a body, because no request to this server needs one.
    // The callback keeps this session alive.
    start_timeout(hub_.options.request_time);
    http::async_read(stream_, buffer_, *parser_,
                     [self = shared_from_this()](Error failed, std::size_t) { self->on_read(failed); });
}

/// Answers a request, or sends an error if it is late or invalid. A client that has sent
/// nothing is disconnected: the session ends, because no callback refers to it any more.
void HttpSession::on_read(Error error) {
    timer_.cancel();
    if (late_) {
        if (parser_->got_some()) send_error(Status::request_timeout);
        return;
    }
    if (!error) return answer_request(parser_->get());
    if (const std::optional<Status> status = parse_status(error)) send_error(*status);
}

/// Returns the first Foxglove subprotocol that a WebSocket handshake requests. A
/// subprotocol is the format of the messages. Returns an empty text if the request is no
/// such handshake, or if this server does not offer Foxglove.
std::string_view HttpSession::offered_protocol(const Request& request) const {
    if (!hub_.events.foxglove_opened || !boost::beast::websocket::is_upgrade(request)) return {};
    for (const auto& requested : http::token_list{request[http::field::sec_websocket_protocol]})
        for (const std::string_view supported_protocol : kFoxgloveProtocols)
            if (to_view(requested) == supported_protocol) return supported_protocol;
    return {};
}

/// Returns the HTTP status if a request is rejected, otherwise no value. The order of the
/// checks reveals as little as possible to a client without access (see server.hpp).
std::optional<HttpSession::Status> HttpSession::access_error(const Request& request, bool foxglove) const {
    // The host name that the client has used must be one of this machine.
    if (request.count(http::field::host) != 1) return Status::bad_request;
    const std::string_view host = to_view(request[http::field::host]);
    if (!is_this_machine(host, hub_.host_name)) return Status::forbidden;

    // The page that sends the request must come from this server, or be Foxglove.
    const std::string& token = hub_.options.token;
    const std::string_view url_token = find_list_value(url_query(to_view(request.target())), "token", '&');
    const bool has_url_token = !token.empty() && is_same_secret(url_token, token);
    if (request.count(http::field::origin) > 1) return Status::forbidden;
    const std::string_view origin = to_view(request[http::field::origin]);
    const bool is_foreign = !is_same_origin(origin, host);
    const bool may_be_foreign = foxglove && (is_foxglove_origin(origin) || has_url_token);
    if (is_foreign && !may_be_foreign) return Status::forbidden;

    // The client must know the token, if there is one. A foreign page must send it in the
    // address, because browsers also send cookies with requests of foreign pages.
    const std::string_view cookie =
        find_list_value(to_view(request[http::field::cookie]), hub_.cookie_name, ';');
    const bool has_cookie = !is_foreign && is_same_secret(cookie, token);
    if (!token.empty() && !has_url_token && !has_cookie) return Status::unauthorized;
    if (request.method() != http::verb::get && request.method() != http::verb::head)
        return Status::method_not_allowed;
    return {};
}

/// Starts a WebSocket or sends a file of the web page. Only files that are compiled into
/// the program can be sent.
void HttpSession::answer_request(const Request& request) {
    const std::string_view foxglove = offered_protocol(request);
    if (const std::optional<Status> status = access_error(request, !foxglove.empty()))
        return send_error(*status);
    const std::string_view target = to_view(request.target()), path = url_path(target);
    const bool is_socket = path == kSocketPath || (path == "/" && !foxglove.empty());
    if (is_socket) {
        if (!boost::beast::websocket::is_upgrade(request)) return send_error(Status::upgrade_required);
        // A client must not send data before the WebSocket handshake is complete.
        if (buffer_.size() > 0) return send_error(Status::bad_request);
        std::make_shared<SocketSession>(std::move(stream_), std::move(counted_), hub_)
            ->accept_handshake(request, foxglove);
        return;
    }
    const auto asset = std::ranges::find(hub_.options.assets, path, &WebPageFile::path);
    if (asset == hub_.options.assets.end()) return send_error(Status::not_found);
    response_ = make_response(Status::ok, std::string(to_view(request[http::field::host])));
    response_->set(http::field::content_type,
                   boost::beast::string_view(asset->type.data(), asset->type.size()));
    // Stores the token in a cookie, so that the page can load its other files without the
    // token in their addresses.
    const bool has_url_token = !find_list_value(url_query(target), "token", '&').empty();
    if (has_url_token && !hub_.options.token.empty())
        response_->set(http::field::set_cookie,
                       hub_.cookie_name + "=" + hub_.options.token + "; Path=/; HttpOnly; SameSite=Strict");
    response_->body() = std::string(asset->body);
    response_->prepare_payload();
    // The header of a response to HEAD contains the length of the body.
    if (request.method() == http::verb::head) response_->body().clear();
    response_->keep_alive(request.keep_alive());
    write_response();
}

/// Returns a response with the security headers and without a body.
/// @param host for the WebSocket address in the security policy, or empty. Needed because
/// some browsers do not include WebSockets in 'self'.
HttpSession::Response HttpSession::make_response(Status status, const std::string& host) const {
    constexpr unsigned kHttpVersion = 11;  // 1.1
    Response response{status, kHttpVersion};
    response.set(http::field::server, "relidar");
    response.set(http::field::content_type, "text/plain; charset=utf-8");
    response.set(http::field::cache_control, "no-cache");
    response.set(
        "Content-Security-Policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'" +
            (host.empty() ? "" : " ws://" + host) +
            "; base-uri 'none'; form-action 'none'; frame-ancestors 'none'");
    response.set("X-Content-Type-Options", "nosniff");
    response.set("X-Frame-Options", "DENY");
    response.set("Referrer-Policy", "no-referrer");
    response.set("Cross-Origin-Opener-Policy", "same-origin");
    response.set("Cross-Origin-Resource-Policy", "same-origin");
    return response;
}

/// Sends an error page and closes the connection.
void HttpSession::send_error(Status status) {
    response_ = make_response(status, "");
    response_->body() = std::string(to_view(http::obsolete_reason(status))) + "\n";
    if (status == Status::unauthorized)
        response_->body() =
            "The access token is wrong or missing. Open the full address that `relidar view` has printed.\n";
    if (status == Status::method_not_allowed) response_->set(http::field::allow, "GET, HEAD");
    if (status == Status::upgrade_required) response_->set(http::field::upgrade, "websocket");
    response_->prepare_payload();
    response_->keep_alive(false);
    write_response();
}

void HttpSession::send_overload() { send_error(Status::service_unavailable); }

/// Sends the response and reads the next request, if the client keeps the connection
/// open. Otherwise ends the connection.
void HttpSession::write_response() {
    start_timeout(hub_.options.idle_time);
    http::async_write(stream_, *response_, [self = shared_from_this()](Error failed, std::size_t) {
        self->timer_.cancel();
        if (failed) return;
        if (self->response_->keep_alive()) {
            self->read_request();
            return;
        }
        // Tells the client that the response is complete, but still reads what it sends.
        Error ignored;
        self->stream_.socket().shutdown(boost::asio::ip::tcp::socket::shutdown_send, ignored);
        self->start_timeout(kDiscardTime);
        self->discard_rest();
    });
}

/// Reads the remaining data of a rejected client for a short time and discards it. If a
/// connection is closed with unread data, the client does not receive the response.
void HttpSession::discard_rest() {
    buffer_.consume(buffer_.size());
    stream_.async_read_some(buffer_.prepare(kDiscardedAtOnce),
                            [self = shared_from_this()](Error failed, std::size_t) {
                                if (!failed && ++self->n_discards_ < kMaxDiscards) self->discard_rest();
                            });
}

}  // namespace relidar::view
