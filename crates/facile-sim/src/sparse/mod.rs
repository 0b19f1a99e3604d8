//! Symmetric positive definite sparse systems: one symbolic analysis (faer), many numeric factors.
//!
//! The elimination order and the supernodes are faer's. The numbers are computed here, by a left-looking supernodal
//! Cholesky factorisation, because faer's kernels use fused operations where the processor has them and so give other
//! bits on other machines; read next `factor`.

mod band;
mod block;
mod factor;

use faer::Side;
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::linalg::{SupernodalThreshold, SymbolicSupernodalParams};

use crate::SimError;
pub(crate) use band::BandMatrix;
pub(crate) use block::{Block, BlockFactor, NO_BLOCK};
pub(crate) use factor::Factor;

/// Supernodes of up to so many columns are merged as long as this share of zeros at most is stored: more, and the zeros
/// cost more than the longer loops save.
const MERGE: &[(usize, f64)] = &[(4, 1.0), (8, 0.4), (16, 0.1), (usize::MAX, 0.01)];

/// The lower triangle of a symmetric matrix, by columns, and the structure of its factor.
#[derive(Debug)]
pub(crate) struct Pattern {
    starts: Vec<u32>,
    rows: Vec<u32>,
    /// Row of the factor of each row.
    order: Vec<u32>,
    supernodes: Vec<Supernode>,
    /// Rows of the factor below the supernodes' diagonal blocks.
    below: Vec<u32>,
    /// For each supernode, which earlier ones change it.
    updates: Vec<Update>,
    /// Where each entry of the matrix is added in the factor's values.
    places: Vec<u32>,
    values: usize,
    /// Most rows of a supernode.
    tallest: usize,
}

/// Columns of the factor with the same rows, stored as one dense block by columns: first the rows of its own columns,
/// then those below.
#[derive(Clone, Copy, Debug)]
struct Supernode {
    start: u32,
    width: u32,
    below: (u32, u32),
    values: u32,
    updates: (u32, u32),
}

impl Supernode {
    fn height(&self) -> usize {
        (self.width + self.below.1 - self.below.0) as usize
    }
}

/// Rows `from..to` below the diagonal block of supernode `source` are columns of the supernode that is changed.
#[derive(Clone, Copy, Debug)]
struct Update {
    source: u32,
    from: u32,
    to: u32,
}

/// Place of an entry in the factor: column and row within a supernode; turned if the elimination exchanges row and column.
#[derive(Clone, Copy, Debug)]
struct Site {
    supernode: usize,
    column: usize,
    row: usize,
    is_turned: bool,
}

impl Pattern {
    /// The pattern of an `n` x `n` matrix with these entries besides its diagonal; order and side do not matter.
    pub(crate) fn new(
        n: usize,
        what: &'static str,
        pairs: impl Iterator<Item = (u32, u32)>,
    ) -> Result<Self, SimError> {
        let mut entries: Vec<(u32, u32)> = pairs
            .map(|(a, b)| (a.min(b), a.max(b)))
            .chain((0..n as u32).map(|i| (i, i)))
            .collect();
        entries.sort_unstable();
        entries.dedup();
        let mut starts = vec![0; n + 1];
        for &(column, _) in &entries {
            starts[column as usize + 1] += 1;
        }
        for k in 0..n {
            starts[k + 1] += starts[k];
        }
        let rows: Vec<u32> = entries.iter().map(|e| e.1).collect();
        let mut pattern = Self {
            starts,
            rows,
            order: Vec::new(),
            supernodes: Vec::new(),
            below: Vec::new(),
            updates: Vec::new(),
            places: Vec::new(),
            values: 0,
            tallest: 0,
        };
        if n > 0 {
            pattern.analyse(what)?;
            pattern.place();
        }
        Ok(pattern)
    }

    fn analyse(&mut self, what: &'static str) -> Result<(), SimError> {
        let n = self.size();
        let structure = SymbolicSparseColMatRef::new_checked(n, n, &self.starts, None, &self.rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            supernodal_params: SymbolicSupernodalParams { relax: Some(MERGE) },
            ..CholeskySymbolicParams::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(structure, Side::Lower, SymmetricOrdering::Amd, params)
                .map_err(|_| SimError::Singular { what, row: 0 })?;
        let SymbolicCholeskyRaw::Supernodal(blocks) = symbolic.raw() else {
            return Err(SimError::Singular { what, row: 0 });
        };
        self.order = match symbolic.perm() {
            Some(order) => order.arrays().1.to_vec(),
            None => (0..n as u32).collect(),
        };
        for s in 0..blocks.n_supernodes() {
            let below = self.below.len() as u32;
            let (start, end) = (blocks.supernode_begin()[s], blocks.supernode_end()[s]);
            self.below.extend(blocks.supernode(s).pattern());
            let supernode = Supernode {
                start,
                width: end - start,
                below: (below, self.below.len() as u32),
                values: self.values as u32,
                updates: (0, 0),
            };
            self.values += supernode.height() * supernode.width as usize;
            self.tallest = self.tallest.max(supernode.height());
            self.supernodes.push(supernode);
        }
        self.link();
        Ok(())
    }

    /// Finds for each supernode the earlier ones that change it.
    fn link(&mut self) {
        let mut owner = vec![0u32; self.size()];
        for (s, block) in self.supernodes.iter().enumerate() {
            owner[block.start as usize..(block.start + block.width) as usize].fill(s as u32);
        }
        let mut changed_by = vec![Vec::new(); self.supernodes.len()];
        for (source, block) in self.supernodes.iter().enumerate() {
            let rows = &self.below[block.below.0 as usize..block.below.1 as usize];
            let mut from = 0;
            while from < rows.len() {
                let target = owner[rows[from] as usize];
                let to = from
                    + rows[from..]
                        .iter()
                        .take_while(|r| owner[**r as usize] == target)
                        .count();
                changed_by[target as usize].push(Update {
                    source: source as u32,
                    from: from as u32,
                    to: to as u32,
                });
                from = to;
            }
        }
        for (block, updates) in self.supernodes.iter_mut().zip(changed_by) {
            let first = self.updates.len() as u32;
            self.updates.extend(updates);
            block.updates = (first, self.updates.len() as u32);
        }
    }

    fn place(&mut self) {
        let sites = self.sites();
        self.places = sites
            .iter()
            .map(|site| {
                let block = &self.supernodes[site.supernode];
                block.values + (site.column * block.height() + site.row) as u32
            })
            .collect();
    }

    /// Where each entry of the matrix is in the factor, slot by slot.
    fn sites(&self) -> Vec<Site> {
        let mut owner = vec![0usize; self.size()];
        for (s, block) in self.supernodes.iter().enumerate() {
            owner[block.start as usize..(block.start + block.width) as usize].fill(s);
        }
        let mut sites = Vec::with_capacity(self.entries());
        for (a, slots) in self.starts.windows(2).enumerate() {
            for &b in &self.rows[slots[0] as usize..slots[1] as usize] {
                let (p, q) = (self.order[a], self.order[b as usize]);
                let (column, row) = (p.min(q), p.max(q));
                let supernode = owner[column as usize];
                let block = &self.supernodes[supernode];
                let row = if row < block.start + block.width {
                    row - block.start
                } else {
                    let rows = &self.below[block.below.0 as usize..block.below.1 as usize];
                    block.width + rows.binary_search(&row).expect("a row of the factor") as u32
                };
                sites.push(Site {
                    supernode,
                    column: (column - block.start) as usize,
                    row: row as usize,
                    is_turned: q < p,
                });
            }
        }
        sites
    }

    /// Column and row of each slot, the larger one second.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.starts.windows(2).enumerate().flat_map(|(a, slots)| {
            let rows = &self.rows[slots[0] as usize..slots[1] as usize];
            rows.iter().map(move |&b| [a as u32, b])
        })
    }

    /// Row of the factor of each row of the matrix.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
    }

    /// Number of rows.
    pub(crate) fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Where the entry of two rows is stored.
    ///
    /// # Panics
    /// If the pattern has no such entry.
    pub(crate) fn slot(&self, a: u32, b: u32) -> u32 {
        let (column, row) = (a.min(b) as usize, a.max(b));
        let start = self.starts[column] as usize;
        let rows = &self.rows[start..self.starts[column + 1] as usize];
        let place = rows.binary_search(&row).expect("an entry of the pattern");
        (start + place) as u32
    }
}
