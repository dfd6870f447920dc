//! The graph's solver: a chain of poses, tied by odometry and each by itself to the map.
//!
//! The map is known, so every measurement holds one pose alone and the normal equations are block tridiagonal. A
//! Gauss-Newton step is one sweep of 3 x 3 blocks down the chain and one back. The last block that the sweep leaves
//! (its Schur complement) is the newest pose's information.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::edges::{self, Frame, wrap};
use super::measurement::{Measurement, MeasurementNoise, Quadratic};
use crate::Pose;

/// A step this small in all components ends the iteration \[m or rad\].
const CONVERGED: f64 = 1e-6;

/// The normal equations are singular or not finite. The poses are as they were; the caller goes on with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the graph's normal equations are singular or not finite")]
pub struct Unsolvable;

/// What holds the oldest pose: d' L d + 2 g' d, where d is its way from `at`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearPrior {
    at: Pose,
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
}

impl LinearPrior {
    /// The prior edge of a pose `z` that is known with `information` in its own frame: its error is linear as it is.
    #[must_use]
    pub fn new(z: Pose, information: Matrix3<f64>) -> Self {
        let (_, jacobian) = edges::prior(z, z);
        Self { at: z, information: jacobian.transpose() * information * jacobian, gradient: Vector3::zeros() }
    }

    fn add_to(&self, total: &mut Quadratic, pose: Pose) {
        let way =
            Vector3::new(pose.x_m - self.at.x_m, pose.y_m - self.at.y_m, wrap(pose.heading_rad - self.at.heading_rad));
        let pull = self.information * way;
        total.information += self.information;
        total.gradient += pull + self.gradient;
        total.cost += way.dot(&pull) + 2.0 * way.dot(&self.gradient);
    }
}

/// An odometry edge: where the node lies, seen from the one before, and the information on that.
#[derive(Debug, Clone, Copy)]
struct Way {
    measured: Pose,
    information: Matrix3<f64>,
}

/// A pose and what was seen from it.
#[derive(Debug, Clone)]
struct Node {
    pose: Pose,
    /// From the node before; the oldest node's is spent.
    way: Way,
    measurements: Vec<Measurement>,
}

/// One node's part of the normal equations.
#[derive(Debug, Clone, Copy)]
struct Block {
    own: Quadratic,
    /// Block to the right of the diagonal: with the next node.
    with_next: Matrix3<f64>,
    /// Inverse of the diagonal once all older nodes are eliminated.
    inverse: Matrix3<f64>,
}

/// The newest poses and all that is known of the older ones.
#[derive(Debug, Clone)]
pub struct Chain {
    window: usize,
    noise: MeasurementNoise,
    prior: LinearPrior,
    /// Never empty.
    nodes: VecDeque<Node>,
    blocks: Vec<Block>,
    before: Vec<Pose>,
}

impl Chain {
    /// A chain of one pose, `prior`'s. It keeps `window` poses, at least 2; `most` measurements of each need no
    /// allocation.
    #[must_use]
    pub fn new(window: usize, most: usize, noise: MeasurementNoise, prior: LinearPrior) -> Self {
        let window = window.max(2);
        let way = Way { measured: Pose::default(), information: Matrix3::zeros() };
        let mut nodes = VecDeque::with_capacity(window);
        nodes.push_back(Node { pose: prior.at, way, measurements: Vec::with_capacity(most) });
        Self { window, noise, prior, nodes, blocks: Vec::with_capacity(window), before: Vec::with_capacity(window) }
    }

    /// Adds a pose, `measured` by the odometry as seen from the newest one with `information`; the oldest pose leaves a
    /// full window.
    ///
    /// # Errors
    /// A pose or an information that is not finite adds nothing.
    pub fn push(&mut self, measured: Pose, information: Matrix3<f64>) -> Result<(), Unsolvable> {
        let mut pose = self.newest().compose(measured);
        pose.heading_rad = wrap(pose.heading_rad);
        if !is_finite(pose) || !information.iter().all(|entry| entry.is_finite()) {
            return Err(Unsolvable);
        }
        let most = self.nodes[0].measurements.capacity();
        let full = self.nodes.len() >= self.window;
        let mut measurements = if full { self.marginalise_oldest() } else { Vec::with_capacity(most) };
        measurements.clear();
        self.nodes.push_back(Node { pose, way: Way { measured, information }, measurements });
        Ok(())
    }

    /// Adds a measurement to the newest pose; an implausible one is left out.
    pub fn measure(&mut self, measurement: Measurement) {
        if measurement.is_plausible() {
            self.nodes.back_mut().expect("never empty").measurements.push(measurement);
        }
    }

    /// The newest pose.
    #[must_use]
    pub fn newest(&self) -> Pose {
        self.nodes.back().expect("never empty").pose
    }

    /// The poses in the window with their measurements, oldest first.
    pub fn nodes(&self) -> impl DoubleEndedIterator<Item = (Pose, &[Measurement])> + ExactSizeIterator {
        self.nodes.iter().map(|node| (node.pose, node.measurements.as_slice()))
    }

    /// Moves the poses to the least cost, in at most `iterations` Gauss-Newton steps; a step that raises it is taken
    /// back. Returns the newest pose's covariance.
    ///
    /// # Errors
    /// A singular system: a pose that nothing holds in some direction.
    pub fn optimise(&mut self, iterations: u32) -> Result<Matrix3<f64>, Unsolvable> {
        let mut cost = self.linearise();
        let mut covariance = self.eliminate()?;
        for _ in 0..iterations {
            self.before.clear();
            self.before.extend(self.nodes.iter().map(|node| node.pose));
            let largest = self.step();
            let next = self.linearise();
            // Not <: a NaN is taken back, too.
            let better = if next <= cost { self.eliminate().ok() } else { None };
            let Some(next_covariance) = better else {
                self.nodes.iter_mut().zip(&self.before).for_each(|(node, before)| node.pose = *before);
                break;
            };
            (cost, covariance) = (next, next_covariance);
            if largest < CONVERGED {
                break;
            }
        }
        Ok(covariance)
    }

    /// The normal equations at the poses as they are; returns the cost.
    fn linearise(&mut self) -> f64 {
        self.blocks.clear();
        let mut total = 0.0;
        for i in 0..self.nodes.len() {
            let mut own = self.unary(i);
            if i > 0 {
                let edge = self.way(i);
                own.information += edge.to.information;
                own.gradient += edge.to.gradient;
                own.cost += edge.to.cost;
                let before = &mut self.blocks[i - 1];
                before.own.information += edge.from.information;
                before.own.gradient += edge.from.gradient;
                before.with_next = edge.between;
            }
            total += own.cost;
            self.blocks.push(Block { own, with_next: Matrix3::zeros(), inverse: Matrix3::zeros() });
        }
        total
    }

    /// What holds node `i` by itself.
    fn unary(&self, i: usize) -> Quadratic {
        let node = &self.nodes[i];
        let frame = Frame::from(node.pose);
        let mut total = Quadratic::default();
        if i == 0 {
            self.prior.add_to(&mut total, node.pose);
        }
        node.measurements.iter().for_each(|one| one.add_to(&mut total, &frame, &self.noise));
        total
    }

    /// The odometry edge from node `i` - 1 to node `i`.
    fn way(&self, i: usize) -> WayEdge {
        let Way { measured, information } = self.nodes[i].way;
        let (error, [by_from, by_to]) = edges::relative(measured, self.nodes[i - 1].pose, self.nodes[i].pose);
        let [weighed_from, weighed_to] = [by_from, by_to].map(|jacobian| jacobian.transpose() * information);
        let from = Quadratic { information: weighed_from * by_from, gradient: weighed_from * error, cost: 0.0 };
        let cost = error.dot(&(information * error));
        let to = Quadratic { information: weighed_to * by_to, gradient: weighed_to * error, cost };
        WayEdge { from, to, between: weighed_from * by_to }
    }

    /// Eliminates all poses but the newest, oldest first.
    fn eliminate_older(&mut self) -> Result<(), Unsolvable> {
        for i in 1..self.blocks.len() {
            let older = &mut self.blocks[i - 1];
            older.inverse = inverse(older.own.information)?;
            let (information, gradient) = schur(&older.own, older.inverse, older.with_next);
            self.blocks[i].own.information -= information;
            self.blocks[i].own.gradient -= gradient;
        }
        Ok(())
    }

    /// Eliminates all; returns the newest pose's covariance.
    fn eliminate(&mut self) -> Result<Matrix3<f64>, Unsolvable> {
        self.eliminate_older()?;
        let newest = self.blocks.last_mut().ok_or(Unsolvable)?;
        newest.inverse = inverse(newest.own.information)?;
        Ok(newest.inverse)
    }

    /// Solves the eliminated system from the newest pose back; returns the largest component of the step.
    fn step(&mut self) -> f64 {
        let (mut newer, mut largest) = (Vector3::zeros(), 0.0_f64);
        for (node, block) in self.nodes.iter_mut().zip(&self.blocks).rev() {
            let step = -(block.inverse * (block.own.gradient + block.with_next * newer));
            node.pose.x_m += step.x;
            node.pose.y_m += step.y;
            node.pose.heading_rad = wrap(node.pose.heading_rad + step.z);
            largest = largest.max(step.amax());
            newer = step;
        }
        largest
    }

    /// Takes out the oldest pose: what it and its edges say becomes the prior of the next. Returns its measurements.
    fn marginalise_oldest(&mut self) -> Vec<Measurement> {
        let edge = self.way(1);
        let mut own = self.unary(0);
        own.information += edge.from.information;
        own.gradient += edge.from.gradient;
        let next = self.nodes[1].pose;
        // Its information holds that of an odometry edge and so has an inverse; if not, nothing is known of the next.
        self.prior = match inverse(own.information) {
            Ok(inverse) => {
                let (information, gradient) = schur(&own, inverse, edge.between);
                let rest = edge.to.information - information;
                let information = 0.5 * (rest + rest.transpose());
                LinearPrior { at: next, information, gradient: edge.to.gradient - gradient }
            }
            Err(Unsolvable) => LinearPrior { at: next, information: Matrix3::zeros(), gradient: Vector3::zeros() },
        };
        self.nodes.pop_front().map(|node| node.measurements).unwrap_or_default()
    }
}

/// An odometry edge's part of the normal equations.
struct WayEdge {
    from: Quadratic,
    to: Quadratic,
    between: Matrix3<f64>,
}

/// What the next node loses when a node is eliminated: of its information and of its gradient.
fn schur(own: &Quadratic, inverse: Matrix3<f64>, with_next: Matrix3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let across = with_next.transpose() * inverse;
    (across * with_next, across * own.gradient)
}

/// By Cholesky: a matrix that is not positive definite has none.
fn inverse(information: Matrix3<f64>) -> Result<Matrix3<f64>, Unsolvable> {
    let inverse = information.cholesky().ok_or(Unsolvable)?.inverse();
    if inverse.iter().all(|entry| entry.is_finite()) { Ok(inverse) } else { Err(Unsolvable) }
}

fn is_finite(pose: Pose) -> bool {
    pose.x_m.is_finite() && pose.y_m.is_finite() && pose.heading_rad.is_finite()
}

#[cfg(test)]
mod tests;
