//! Connections: how many there are, how long they may take, and their encryption.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::access::Peer;
use super::events::Stopping;
use super::{App, router};

/// Connections at a time; further ones are closed at once.
const CONNECTIONS: usize = 512;

/// Connections at a time from one address, unless a proxy stands in front.
const CONNECTIONS_OF_ONE: usize = 256;

/// A client has so long for its part of the encryption's beginning.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(10);

/// A client has so long to send a request's head, from the end of the one before.
const HEAD_WITHIN: Duration = Duration::from_secs(10);

/// A client that takes nothing of an answer for so long is given up.
const STALLED_FOR: Duration = Duration::from_secs(30);

/// A request's head is at most this many bytes long.
const HEAD_BYTES: usize = 32 << 10;

/// A request has at most so many headers.
const HEADERS: usize = 64;

/// After a failure to accept that is not one connection's (no more files), how long until the next attempt.
const REST: Duration = Duration::from_millis(200);

/// Serves `app` on `listener` until `stop` is cancelled; requests under way are answered first.
///
/// # Errors
/// None at present: what fails is one connection's.
pub async fn serve(listener: TcpListener, app: App, stop: CancellationToken) -> io::Result<()> {
    let acceptor = app.access().tls.clone().map(TlsAcceptor::from);
    let of_one = if app.access().proxied { CONNECTIONS } else { CONNECTIONS_OF_ONE };
    let places = Arc::new(Places { total: CONNECTIONS, of_one, taken: Mutex::default() });
    let (router, graceful) = (router(app), GracefulShutdown::new());
    while let Some(accepted) = stop.run_until_cancelled(listener.accept()).await {
        let Some((stream, peer)) = usable(accepted).await else { continue };
        let Some(place) = places.take(peer.ip()) else {
            tracing::debug!(%peer, "too many connections: one was closed");
            continue;
        };
        let connection = Connection { peer: peer.ip(), router: router.clone(), stop: stop.clone() };
        let (acceptor, watcher) = (acceptor.clone(), graceful.watcher());
        tokio::spawn(async move {
            if let Err(error) = converse(stream, connection, acceptor, watcher).await {
                tracing::debug!(%peer, %error, "a connection ended badly");
            }
            drop(place);
        });
    }
    drop(listener);
    graceful.shutdown().await;
    Ok(())
}

async fn usable(accepted: io::Result<(TcpStream, SocketAddr)>) -> Option<(TcpStream, SocketAddr)> {
    match accepted {
        Ok(connection) => Some(connection),
        Err(error) => {
            tracing::warn!(%error, "a connection could not be accepted");
            tokio::time::sleep(REST).await;
            None
        }
    }
}

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// From whom, to what, and until when.
struct Connection {
    peer: IpAddr,
    router: Router,
    stop: CancellationToken,
}

async fn converse(
    stream: TcpStream,
    connection: Connection,
    acceptor: Option<TlsAcceptor>,
    watcher: Watcher,
) -> Result<(), Failure> {
    stream.set_nodelay(true)?;
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(STALLED_FOR));
    let stream: Pin<Box<TimeoutStream<TcpStream>>> = Box::pin(stream);
    match acceptor {
        None => answer(stream, connection, watcher).await,
        Some(acceptor) => {
            let stream = tokio::time::timeout(HANDSHAKE_WITHIN, acceptor.accept(stream)).await??;
            answer(stream, connection, watcher).await
        }
    }
}

async fn answer<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(
    stream: S,
    connection: Connection,
    watcher: Watcher,
) -> Result<(), Failure> {
    let Connection { peer, router, stop } = connection;
    let service = hyper::service::service_fn(move |request: Request<Incoming>| {
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(Peer(peer));
        request.extensions_mut().insert(Stopping(stop.clone()));
        router.clone().oneshot(request)
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_headers(HEADERS).max_buf_size(HEAD_BYTES);
    Ok(watcher.watch(http.serve_connection(TokioIo::new(stream), service)).await?)
}

/// How many connections there are, by address.
#[derive(Debug)]
struct Places {
    total: usize,
    of_one: usize,
    taken: Mutex<HashMap<IpAddr, usize>>,
}

impl Places {
    fn take(self: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if taken.values().sum::<usize>() >= self.total || taken.get(&address).is_some_and(|n| *n >= self.of_one) {
            return None;
        }
        *taken.entry(address).or_default() += 1;
        Some(Place { places: Arc::clone(self), address })
    }
}

/// One connection's place; free again when dropped.
#[derive(Debug)]
struct Place {
    places: Arc<Places>,
    address: IpAddr,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(n) = taken.get_mut(&self.address) {
            *n -= 1;
            if *n == 0 {
                taken.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_limited_in_all_and_for_each_address_and_come_back() {
        let places = Arc::new(Places { total: 3, of_one: 2, taken: Mutex::default() });
        let at = |n: u8| IpAddr::from([192, 0, 2, n]);
        let held = [places.take(at(1)).unwrap(), places.take(at(1)).unwrap()];
        assert!(places.take(at(1)).is_none());
        let third = places.take(at(2)).unwrap();
        assert!(places.take(at(3)).is_none());
        drop(third);
        drop(held);
        assert!(places.take(at(3)).is_some());
        assert!(places.taken.lock().unwrap().is_empty(), "nothing is kept of who left");
    }
}
