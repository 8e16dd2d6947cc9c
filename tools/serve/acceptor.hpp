// SPDX-License-Identifier: Apache-2.0
// Accepts network connections and passes them to gRPC. gRPC 1.51 could accept connections
// itself, but it stops permanently when no file descriptor is free.
#pragma once

#include <functional>
#include <string>
#include <thread>
#include <vector>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

namespace relidar::serve {

class Acceptor {
public:
    /// Must close the file descriptor. Runs on the thread of the acceptor.
    using ConnectionCallback = std::function<void(int listener, int connection)>;

    /// Listens at all addresses of a host name.
    /// @param address HOST:PORT; port 0 selects a free port, which is the same for all
    /// @throws UsageError if the address is invalid or not available
    explicit Acceptor(const std::string& address);
    ~Acceptor();

    int port() const { return port_; }
    /// If too few file descriptors are free, closes new connections immediately.
    void start_accepting(ConnectionCallback handle_connection);
    void stop();

private:
    boost::asio::io_context io_{1};
    std::vector<boost::asio::ip::tcp::acceptor> listeners_;
    int port_ = 0;
    ConnectionCallback receive_;
    std::thread thread_;

    void accept_next(boost::asio::ip::tcp::acceptor& listener);
};

}  // namespace relidar::serve
